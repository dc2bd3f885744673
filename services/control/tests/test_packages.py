"""Blocks compiled ahead of time: made, found, refused with a reason, and equal to what they were made from."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from armsight_control.solvers import blocks, packages
from armsight_control.solvers.compile import compile_block
from armsight_control.solvers.packages import Baseline, block, describe, path_of, refusal_of, superseded

ANY_CPU = Baseline("x86-64", 128, ())


@pytest.fixture
def package(tmp_path: Path) -> Path:
    path = path_of("damped", 2, tmp_path)
    path.write_bytes(b"not a package")
    describe(path, ANY_CPU)
    return path


def test_a_package_is_refused_with_the_reason_and_what_to_do(package: Path) -> None:
    assert refusal_of(package) == ""
    described = package.with_suffix(".json")
    good = json.loads(described.read_text())
    for change, text in (
        ({"torch": "1.0"}, "made with torch 1.0"),
        ({"machine": "vax"}, "made for vax"),
        ({"flags": ["avx2", "warp9"], "march": "x86-64-v9"}, "x86-64-v9: this CPU lacks"),
        ({"colour": "red"}, "can't be read"),
    ):
        described.write_text(json.dumps(good | change))
        assert text in refusal_of(package)
    described.write_text("{")
    assert "can't be read" in refusal_of(package)
    described.unlink()
    assert "run `python -m armsight_control.solvers.compile`" in refusal_of(package)


def test_what_this_cpu_has_is_read_from_the_system() -> None:
    first = Path("/proc/cpuinfo").read_text().lower()
    assert packages.cpu_flags()
    assert all(flag in first for flag in packages.cpu_flags())


def test_without_a_package_that_loads_a_block_runs_eagerly_and_says_why(tmp_path: Path, package: Path) -> None:
    without = block("damped", 3, folder=tmp_path)
    assert without.backend == "eager"
    assert "damped for 3 joints runs uncompiled: no package" in without.trouble
    broken = block("damped", 2, folder=package.parent)
    assert broken.backend == "eager"
    assert "can't be loaded" in broken.trouble


def test_the_name_of_a_package_changes_with_the_source_it_was_made_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = path_of("descent", 3, tmp_path)
    other = tmp_path / "blocks.py"
    other.write_text("other source")
    monkeypatch.setattr(blocks, "__file__", str(other))
    assert path_of("descent", 3, tmp_path) != before
    assert torch.__version__ in before.name


def test_packages_of_another_source_or_torch_are_superseded(tmp_path: Path, package: Path) -> None:
    old = tmp_path / package.name.replace("torch", "torch1.0.")
    old.write_bytes(b"")
    describe(old, ANY_CPU)
    (tmp_path / "notes.json").write_text("{}")
    assert sorted(superseded(tmp_path)) == sorted([old, old.with_suffix(".json")])


@pytest.mark.long
@pytest.mark.parametrize("kind", ["descent", "damped"])
def test_a_compiled_block_does_what_its_source_does(kind: packages.Kind, tmp_path: Path) -> None:
    path = compile_block(kind, 1, tmp_path, packages.BASELINES[os.uname().machine])
    assert refusal_of(path) == ""
    compiled = block(kind, 1, folder=tmp_path)
    assert compiled.backend == "compiled"
    rng = np.random.default_rng(5)
    for columns in (4, 12, 1000):
        dtype = packages.DTYPES[kind]

        def random(*shape: int, dtype: torch.dtype = dtype) -> torch.Tensor:
            return torch.tensor(rng.uniform(0.1, 1, shape), dtype=dtype)

        if kind == "descent":
            state = (random(1, columns), random(1, columns))
            rest = (torch.tensor([[0.2, 0.9, 0.05]], dtype=dtype), torch.tensor([0.8, 1e-4], dtype=dtype))
        else:
            state = (random(1, columns), random(columns))
            rest = (torch.tensor([[0.2, 0.9]], dtype=dtype), torch.tensor([1e-12], dtype=dtype))
        inputs = (*state, random(3, columns), random(1, 5), *rest)
        eager = packages.MODULES[kind]()(*inputs)
        for expected, found in zip(eager, compiled.call(inputs), strict=True):
            np.testing.assert_allclose(found.numpy(), expected.numpy(), rtol=1e-4, atol=1e-5)


def test_a_process_that_is_killed_leaves_nothing_that_torch_unpacked(tmp_path: Path) -> None:
    program = """
import os, signal
from armsight_control.solvers.packages import block
assert block("descent", 3).backend == "compiled", block("descent", 3).trouble
assert "TMPDIR" in os.environ
os.kill(os.getpid(), signal.SIGKILL)
"""
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | {"TMPDIR": str(tmp_path)}, capture_output=True, text=True
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert list(tmp_path.iterdir()) == []
