"""The solver's own process: started once, restarted when it dies, gone with its parent."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from armsight_control.description import Arm
from armsight_control.errors import SolverError
from armsight_control.kinematics import forward
from armsight_control.solvers import REPORT_FREE, GradientDescentOptions, Options, Problem, Status
from armsight_control.solvers.process import Solvers

# torch takes five seconds to load on a quiet machine
LOADED_S = 90.0


def until(condition: Callable[[], bool], timeout_s: float = LOADED_S) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.02)


def children_of(pid: int) -> list[int]:
    lists = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(child) for listed in lists for child in listed.read_text().split()]


@pytest.fixture
def solvers() -> Iterator[Solvers]:
    solvers = Solvers()
    yield solvers
    solvers.close()


@pytest.fixture
def problem(arm: Arm) -> Problem:
    options = Options(gradient_descent=GradientDescentOptions(max_steps=5000))
    return Problem(arm.chain, np.array([3.6, 1.2, 7.5]), np.array([0.1, 0.0, -0.4, 0.4]), REPORT_FREE, options)


def test_the_loops_process_never_imports_torch() -> None:
    code = "import sys, armsight_control.service as s; s.Pursuit; print('torch' in sys.modules)"
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.strip() == "False"


def test_the_closed_form_answers_at_once_without_a_process(solvers: Solvers, problem: Problem) -> None:
    assert solvers.submit("closed-form", problem).result(timeout=0).solution.residual_m < 1e-9
    assert not solvers.loading


def test_a_descent_is_solved_beside_and_a_killed_process_is_started_again(solvers: Solvers, problem: Problem) -> None:
    first = solvers.submit("gradient-descent", problem)
    assert solvers.loading
    assert first.result(timeout=LOADED_S).solution.converged
    assert first.result().seconds > 0
    (worker,) = children_of_this(solvers)
    os.kill(worker, signal.SIGKILL)
    until(lambda: solvers.loading)
    until(lambda: bool(solvers.trouble), 5)
    again = solvers.submit("gradient-descent", problem)
    assert again.result(timeout=LOADED_S).solution.converged
    assert solvers.restarts == 1
    assert not solvers.trouble


def children_of_this(solvers: Solvers) -> list[int]:
    assert solvers is not None
    return [
        child
        for child in children_of(os.getpid())
        if "armsight_control.solvers.worker" in Path(f"/proc/{child}/cmdline").read_text()
    ]


def test_a_process_that_dies_over_a_target_fails_that_target_alone(solvers: Solvers, problem: Problem) -> None:
    until_ready = solvers.submit("gradient-descent", problem)
    until_ready.result(timeout=LOADED_S)
    options = Options(gradient_descent=GradientDescentOptions(alpha=1e-9, max_steps=100_000))
    slow = replace(problem, target=np.array([0.0, 0.0, 9.9]), options=options)
    job = solvers.submit("gradient-descent", slow)
    until(job.running)
    for worker in children_of_this(solvers):
        os.kill(worker, signal.SIGKILL)
    with pytest.raises(SolverError, match="died over this target"):
        job.result(timeout=10)


def test_the_process_dies_with_its_parent() -> None:
    code = (
        "import time; from armsight_control.solvers.process import Solvers\n"
        "s = Solvers(); s.prepare('gradient-descent'); print('started', flush=True); time.sleep(60)"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    try:
        until(lambda: bool(children_of(parent.pid)), 20)
        (worker,) = children_of(parent.pid)
        time.sleep(1.0)  # in the midst of loading torch
    finally:
        parent.kill()
        parent.wait()
    until(lambda: not Path(f"/proc/{worker}").exists() or is_zombie(worker), 3)


def is_zombie(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def test_closing_ends_the_process_within_a_second(problem: Problem) -> None:
    solvers = Solvers()
    solvers.submit("gradient-descent", problem).result(timeout=LOADED_S)
    (worker,) = children_of_this(solvers)
    began = time.monotonic()
    solvers.close()
    assert not Path(f"/proc/{worker}").exists()
    assert time.monotonic() - began < 1.0


def test_a_batch_is_solved_beside_whatever_the_solver(solvers: Solvers, problem: Problem) -> None:
    targets = np.array([[3.6, 1.2, 7.5], [9.0, 0.0, 5.0], [2.0, -2.0, 8.0]])
    starts = np.tile(problem.start, (3, 1))
    for name in ("closed-form", "torch"):
        job = solvers.submit_batch(name, problem.chain, targets, starts, REPORT_FREE, problem.options)
        found = job.result(timeout=LOADED_S)
        assert found.seconds > 0
        assert found.solution.status == (Status.CONVERGED, Status.UNREACHABLE, Status.CONVERGED)
        off = np.linalg.norm(forward(problem.chain, found.solution.q) - targets, axis=1)
        np.testing.assert_allclose(off, found.solution.residual_m, atol=1e-12)
        assert off[[0, 2]].max() < 1e-4
    refused = solvers.submit_batch("torch", problem.chain, targets, starts, (7,), problem.options)
    with pytest.raises(SolverError, match="expected some of 0 to 3"):
        refused.result(timeout=10)


def test_the_process_says_how_its_solvers_run(solvers: Solvers, problem: Problem) -> None:
    solution = solvers.submit("torch", problem).result(timeout=LOADED_S).solution
    assert solution.status == Status.CONVERGED
    assert (solvers.note == "") == (solution.note == "")


def test_an_unknown_solver_is_refused_with_those_that_there_are(solvers: Solvers, problem: Problem) -> None:
    with pytest.raises(SolverError, match="there are torch, gradient-descent, levenberg-marquardt, closed-form"):
        solvers.submit("newton", problem)
