"""Where the executables of the services are."""

import os
import sys
from collections.abc import Mapping
from pathlib import Path

import armsight_operator
from armsight_operator.errors import MissingExecutableError

VISION_VARIABLE = "ARMSIGHT_VISION"

_SCRIPTS = {
    "router": "armsight",
    "page": "armsight",
    "sim": "armsight-sim",
    "control": "armsight-control",
    "camera": "armsight-camera",
}


def repository_root() -> Path:
    """Where ``services/operator/armsight_operator`` is installed from, when it is installed editable."""
    return Path(armsight_operator.__file__).resolve().parents[3]


def find_executable(
    name: str,
    environment: Mapping[str, str] = os.environ,
    scripts: Path | None = None,
    root: Path | None = None,
) -> Path:
    """The executable of a service.

    Args:
        name: ``router``, ``sim``, ``vision``, ``control``, ``page`` or ``camera``.
        environment: its ``ARMSIGHT_VISION`` wins over the built one.
        scripts: folder of the console scripts (default: beside this Python).
        root: folder of the repository (default: where this package is).

    Raises:
        MissingExecutableError: it is not there, and how to get it.
    """
    if name == "vision":
        override = environment.get(VISION_VARIABLE)
        built = (root or repository_root()) / "build" / "vision" / "armsight-vision"
        found = Path(override) if override else built
    else:
        # Not resolved: in a virtual environment the interpreter is a link, the scripts lie beside the link.
        found = (scripts or Path(sys.executable).parent) / _SCRIPTS[name]
    if os.access(found, os.X_OK) and found.is_file():
        return found
    hint = f"check {VISION_VARIABLE}" if name == "vision" and environment.get(VISION_VARIABLE) else "run `make setup`"
    raise MissingExecutableError(f"{name} is not installed: there is no executable {found}; {hint}")
