"""Parts of a person's own: found where they stand, held to what ours are held to, and never imported for the bus."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from armsight.counters import Counters
from armsight_control import Arm, Problem, forward, solve, solve_batch
from armsight_control import own as own_parts
from armsight_control.errors import ControlError, OwnPartError, PositionsError, SolverError
from armsight_control.estimators import observer_of
from armsight_control.positions import Positions
from armsight_control.settings import parser, settings_of
from armsight_control.solvers import Status
from armsight_control.solvers.process import Solvers
from armsight_control.tuning import tunables

SOLVERS = """
import numpy as np

def stays(chain, target, start, free):
    return start

def knows(chain, target, start, free):
    from armsight_control.solvers import Problem, solve
    return solve("levenberg-marquardt", Problem(chain, target, start, free)).q

def moves_all(chain, target, start, free):
    return start + 0.1

def beyond(chain, target, start, free):
    return np.full(len(start), 9.0)

def spoils(chain, target, start, free):
    target[:], start[:] = 0, 0
    return [0.0, 0.0, 0.0, 0.0]

def short(chain, target, start, free):
    return start[:2]

def not_finite(chain, target, start, free):
    return start * np.nan

def fails(chain, target, start, free):
    raise KeyError("no idea")

def lends(chain, target, start, free):
    start.flags.writeable = False
    return start

NUMBER = 5
"""
ESTIMATORS = """
class Setpoint:
    def __init__(self, arm): pass
    def step(self, positions, setpoint): return setpoint

class Fails(Setpoint):
    def step(self, positions, setpoint): raise IndexError("out of it")

class Short(Setpoint):
    def step(self, positions, setpoint): return setpoint[:1]

class NotFinite(Setpoint):
    def step(self, positions, setpoint): return setpoint * float("nan")

class NotMade(Setpoint):
    def __init__(self, arm): raise ValueError(f"{arm.chain.count} joints are too many")
"""
START = np.array([0.3, 0.2, -0.5, 0.5])
FREE = (0, 2, 3)


@pytest.fixture
def solvers(tmp_path: Path) -> str:
    (tmp_path / "mine.py").write_text(SOLVERS)
    return str(tmp_path / "mine.py")


@pytest.fixture
def estimators(tmp_path: Path) -> str:
    (tmp_path / "mine.py").write_text(ESTIMATORS)
    return str(tmp_path / "mine.py")


def test_a_part_is_found_in_a_file_and_in_a_module(solvers: str) -> None:
    assert callable(own_parts.load(f"{solvers}:stays"))
    assert own_parts.load("armsight_control.kinematics:forward") is forward


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("mine.py:", "expected module:name or file.py:name"),
        (":solve", "expected module:name or file.py:name"),
        ("mine.py:solve(1)", "expected module:name or file.py:name"),
        ("no_such_module_here:solve", "can't be imported: ModuleNotFoundError"),
        ("/no/such/file.py:solve", "can't be imported: FileNotFoundError"),
        ("armsight_control.kinematics:nothing", "has no function or class nothing"),
    ],
)
def test_a_place_without_a_part_is_refused_with_what_is_wrong(place: str, said: str) -> None:
    with pytest.raises(OwnPartError, match=said):
        own_parts.load(place)


def test_a_file_that_fails_while_it_is_imported_is_refused(tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text("1 / 0")
    with pytest.raises(OwnPartError, match="ZeroDivisionError"):
        own_parts.load(f"{tmp_path / 'broken.py'}:solve")


def test_a_file_that_ends_the_process_while_it_is_imported_is_refused(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text("import sys\ndef solve(*_): ...\nsys.exit(0)")
    with pytest.raises(OwnPartError, match="SystemExit: 0"):
        own_parts.load(f"{tmp_path / 'script.py'}:solve")


def test_a_file_may_have_dataclasses_with_annotations_that_are_not_evaluated(tmp_path: Path) -> None:
    lines = (
        "from __future__ import annotations",
        "from dataclasses import dataclass",
        "@dataclass",
        "class Gains:",
        "    p: float",
    )
    (tmp_path / "typed.py").write_text("\n".join(lines))
    assert own_parts.load(f"{tmp_path / 'typed.py'}:Gains")(2.0).p == 2.0


def test_what_is_no_function_is_refused(solvers: str) -> None:
    with pytest.raises(OwnPartError, match="no function or class NUMBER"):
        own_parts.load(f"{solvers}:NUMBER")


@pytest.mark.parametrize("flag", ["--solver", "--estimator"])
def test_control_does_not_start_with_a_part_that_is_not_there(flag: str) -> None:
    command = [sys.executable, "-m", "armsight_control.service", flag, "no_such_module_here:Mine"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert "control: no_such_module_here:Mine: no_such_module_here can't be imported" in done.stderr


def test_a_solver_of_ones_own_solves_and_is_judged_by_where_the_tip_is(arm: Arm, solvers: str) -> None:
    target = forward(arm.chain, np.array([0.4, 0.2, -0.6, 0.7]))
    there = solve(f"{solvers}:knows", Problem(arm.chain, target, START, (0, 1, 2, 3)))
    assert (there.status, there.converged) == (Status.CONVERGED, True)
    assert there.residual_m < 1e-6
    short_of_it = solve(f"{solvers}:stays", Problem(arm.chain, target, START, (0, 1, 2, 3)))
    assert (short_of_it.status, short_of_it.converged) == (Status.STEP_LIMIT, False)
    assert short_of_it.residual_m == pytest.approx(np.linalg.norm(forward(arm.chain, START) - target))


def test_what_it_moves_without_being_free_stays_and_what_is_beyond_a_limit_is_clamped(arm: Arm, solvers: str) -> None:
    problem = Problem(arm.chain, np.array([3.0, 2.0, 7.0]), START, FREE)
    assert solve(f"{solvers}:moves_all", problem).q == pytest.approx(START + np.array([0.1, 0, 0.1, 0.1]))
    assert solve(f"{solvers}:beyond", problem).q == pytest.approx([np.pi, 0.2, np.pi / 2, np.pi / 2])


def test_what_it_does_to_its_arguments_changes_nothing(arm: Arm, solvers: str) -> None:
    targets, starts = np.array([[3.0, 2.0, 7.0]]), START[None].copy()
    solutions = solve_batch(f"{solvers}:spoils", arm.chain, targets, starts, FREE)
    assert targets.tolist() == [[3.0, 2.0, 7.0]]
    assert starts.tolist() == [START.tolist()]
    assert solutions.q[0].tolist() == [0.0, 0.2, 0.0, 0.0]


def test_an_answer_that_may_not_be_written_to_is_taken_as_well(arm: Arm, solvers: str) -> None:
    problem = Problem(arm.chain, np.array([3.0, 2.0, 7.0]), START, FREE)
    assert solve(f"{solvers}:lends", problem).q == pytest.approx(START)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("short", "expected 4 finite angles"),
        ("not_finite", "expected 4 finite angles"),
        ("fails", "failed: KeyError: 'no idea'"),
    ],
)
def test_a_solver_that_gives_no_configuration_has_no_solution(arm: Arm, solvers: str, name: str, said: str) -> None:
    with pytest.raises(SolverError, match=said):
        solve(f"{solvers}:{name}", Problem(arm.chain, np.array([3.0, 2.0, 7.0]), START, FREE))


def test_it_solves_beside_the_loop_and_its_failure_leaves_the_process_well(arm: Arm, solvers: str) -> None:
    process = Solvers()
    try:
        problem = Problem(arm.chain, np.array([3.0, 2.0, 7.0]), START, FREE)
        with pytest.raises(SolverError, match="no idea"):
            process.submit(f"{solvers}:fails", problem).result(timeout=60)
        assert process.submit(f"{solvers}:stays", problem).result(timeout=10).solution.q == pytest.approx(START)
        assert process.restarts == 0
    finally:
        process.close()


def test_an_estimator_of_ones_own_is_asked_for_the_angles(arm: Arm, estimators: str) -> None:
    observer = observer_of(f"{estimators}:Setpoint", arm, Counters())
    estimate, tip = observer.look(Positions(1, {}), START, "part1")
    assert estimate.angles == pytest.approx(START)
    assert tip == pytest.approx(forward(arm.chain, START))
    assert estimate.estimator == f"{estimators}:Setpoint"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Fails", "failed: IndexError: out of it"),
        ("Short", "expected 4 finite angles"),
        ("NotFinite", "expected 4 finite angles"),
    ],
)
def test_an_estimator_that_fails_leaves_the_arm_blind(arm: Arm, estimators: str, name: str, said: str) -> None:
    observer = observer_of(f"{estimators}:{name}", arm, Counters())
    with pytest.raises(PositionsError, match=said) as refusal:
        observer.look(Positions(1, {}), START, "part1")
    assert refusal.value.reason == "estimator"


def test_an_estimator_that_is_not_for_this_arm_says_so(arm: Arm, estimators: str) -> None:
    with pytest.raises(ControlError, match="can't be made: ValueError: 4 joints are too many"):
        observer_of(f"{estimators}:NotMade", arm, Counters())


def test_while_it_runs_control_takes_no_other_part_than_the_one_it_was_started_with(solvers: str) -> None:
    settings = settings_of(parser().parse_args(["--solver", f"{solvers}:stays"]))
    choices = {tunable.name: tunable.choices for tunable in tunables(settings)}
    assert f"{solvers}:stays" in choices["solver"]
    assert [name for name in choices["solver"] if ":" in name] == [f"{solvers}:stays"]
    assert not [name for name in choices["estimator"] if ":" in name]
