"""Parts of a person's own, by where they stand: ``module:name``, or ``file.py:name``.

Such a place is only ever taken from the command line: what comes over the bus may name a part that this process was
started with, and imports nothing.
"""

import importlib
import importlib.util
import sys
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

from armsight_control.errors import OwnPartError

_MARK = ":"


def is_place(name: str) -> bool:
    """Whether this is a place and not the name of a part of ours."""
    return _MARK in name


@lru_cache(maxsize=16)
def load(place: str) -> Callable[..., Any]:
    """What stands there.

    Args:
        place: an importable module, or a file that ends in ``.py``, then a colon and the name of a function or class.

    Raises:
        OwnPartError: there is no such module or file, it fails while it is imported, or it has nothing to call by
            this name.
    """
    where, _, name = place.partition(_MARK)
    if not where or not name.isidentifier():
        raise OwnPartError(f"{place!r} is no place of a part: expected module:name or file.py:name")
    try:
        module = _module_of_file(Path(where)) if where.endswith(".py") else importlib.import_module(where)
    except (Exception, SystemExit) as error:  # somebody else's code: anything can go wrong in it
        raise OwnPartError(f"{place}: {where} can't be imported: {type(error).__name__}: {error}") from error
    part = getattr(module, name, None)
    if not callable(part):
        raise OwnPartError(f"{place}: {where} has no function or class {name}")
    return part  # type: ignore[no-any-return]


def _module_of_file(file: Path) -> ModuleType:
    name = str(file.resolve())  # no module that can be imported is called so: it takes the place of none
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses and pickle look for their module there
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
