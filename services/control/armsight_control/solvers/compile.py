"""Compiles the solvers' blocks ahead of time: `python -m armsight_control.solvers.compile`.

Whoever runs a solver then waits for no compiler and needs none. It takes minutes and a C++ compiler; packages that are
there already, for this torch and this source, are kept, others removed.
"""

import argparse
import platform
import shutil
import stat
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

import torch
from torch._inductor import aoti_compile_and_package

from armsight_control.errors import ControlError
from armsight_control.solvers.packages import (
    BASELINES,
    COMPILED,
    DTYPES,
    MODULES,
    PREPARED,
    Baseline,
    Kind,
    describe,
    inductor_options,
    path_of,
    refusal_of,
    superseded,
)

_MOST_COLUMNS = 1 << 24


def compile_block(kind: Kind, joints: int, folder: Path, baseline: Baseline) -> Path:
    """Makes one package.

    Raises:
        ControlError: there is no C++ compiler.
    """
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        raise ControlError("no C++ compiler: install g++, or do without (the solvers then run uncompiled)")
    folder.mkdir(parents=True, exist_ok=True)
    path = path_of(kind, joints, folder)
    columns = torch.export.Dim("columns", min=2, max=_MOST_COLUMNS)
    example, shapes = _example(kind, joints, columns)
    program = torch.export.export(MODULES[kind]().eval(), example, dynamic_shapes=shapes, strict=False)
    with tempfile.TemporaryDirectory() as scratch:
        # inductor knows a compiler by its name
        wrapper = Path(scratch) / Path(compiler).name
        wrapper.write_text(f'#!/bin/sh\nexec {compiler} "$@" -march={baseline.march}\n', encoding="utf-8")
        wrapper.chmod(wrapper.stat().st_mode | stat.S_IXUSR)
        made = Path(scratch) / "made.pt2"
        aoti_compile_and_package(program, package_path=str(made), inductor_configs=inductor_options(baseline, wrapper))
        shutil.move(made, path)
    describe(path, baseline)
    return path


def _example(
    kind: Kind, joints: int, columns: object
) -> tuple[tuple[torch.Tensor, ...], tuple[dict[int, object] | None, ...]]:
    rows = {
        "descent": ((joints, 8), (joints, 8), (3, 8), (joints, 5), (joints, 3), (2,)),
        "damped": ((joints, 8), (8,), (3, 8), (joints, 5), (joints, 2), (1,)),
    }[kind]
    example = tuple(torch.ones(shape, dtype=DTYPES[kind]) for shape in rows)
    return example, tuple({len(shape) - 1: columns} if shape[-1] == 8 else None for shape in rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """Compiles what is missing."""
    parser = argparse.ArgumentParser(prog="python -m armsight_control.solvers.compile", description=__doc__)
    parser.add_argument(
        "--joints", type=int, nargs="+", default=list(PREPARED), help="how many are free (default: 3 4)"
    )
    parser.add_argument("--folder", type=Path, default=COMPILED, help="where to (default: inside the package)")
    options = parser.parse_args(arguments)
    baseline = BASELINES.get(platform.machine())
    if baseline is None:
        known = ", ".join(BASELINES)
        print(f"compile: no baseline is stated for {platform.machine()} (there are {known}): solvers run uncompiled")
        return 0
    for kind in MODULES:
        for joints in options.joints:
            if not refusal_of(path_of(kind, joints, options.folder)):
                continue
            began = perf_counter()
            try:
                path = compile_block(kind, joints, options.folder, baseline)
            except ControlError as error:
                print(f"compile: {error}", file=sys.stderr)
                return 1
            print(f"{path.name}: {perf_counter() - began:.0f} s", flush=True)
    for path in superseded(options.folder):
        path.unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main())
