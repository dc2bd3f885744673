"""Inverse kinematics: pure functions from a problem to a solution, by name.

A target that no configuration reaches is moved to the nearest point that one does before any solver sees it, and the
solution says so: near and beyond the edge of the workspace all solvers then behave alike.
"""

import math
from collections.abc import Callable

import numpy as np

from armsight_control.chain import Array
from armsight_control.errors import SolverError
from armsight_control.kinematics import Links, links_of, report_forward
from armsight_control.solvers import closed_form
from armsight_control.solvers.problem import Options, Problem, Solution, Status
from armsight_control.solvers.workspace import nearest_reachable

__all__ = ["BESIDE_THE_LOOP", "SOLVERS", "Options", "Problem", "Solution", "Status", "check_solver", "solve"]

_FREE = [0, 2, 3]
"""Theta, phi and psi: joint 2 stays at 0."""


def _closed_form(links: Links, limits: Array, target: Array, start: Array, options: Options) -> tuple[Array, int, bool]:
    del limits, options
    return closed_form.nearest(links, target, start), 0, True


def _gradient_descent(
    links: Links, limits: Array, target: Array, start: Array, options: Options
) -> tuple[Array, int, bool]:
    from armsight_control.solvers import gradient_descent  # takes seconds: it imports torch

    return gradient_descent.descend(links, limits, target, start, options)


SOLVERS: dict[str, Callable[[Links, Array, Array, Array, Options], tuple[Array, int, bool]]] = {
    "gradient-descent": _gradient_descent,
    "closed-form": _closed_form,
}

BESIDE_THE_LOOP = frozenset({"gradient-descent"})
"""Too slow, or too slow to load, for the process that answers frames."""


def check_solver(name: str) -> None:
    """Refuses a name that no solver has.

    Raises:
        SolverError: with the names that there are.
    """
    if name not in SOLVERS:
        raise SolverError(f"no solver {name!r}; there are {', '.join(SOLVERS)}")


def solve(name: str, problem: Problem) -> Solution:
    """Solves a problem.

    Raises:
        SolverError: no solver of that name.
        UnsupportedArmError: the chain is not of the report's shape.
    """
    check_solver(name)
    chain, links = problem.chain, links_of(problem.chain)
    start = chain.clip(problem.start)[_FREE]
    tip = report_forward(links, start)
    aim, reachable = nearest_reachable(links, problem.target, math.atan2(tip[1], tip[0]))
    found, iterations, converged = SOLVERS[name](links, chain.limits[_FREE], aim, start, problem.options)
    q = np.zeros(chain.count)
    q[_FREE] = found
    q = chain.clip(q)
    tip = report_forward(links, q[_FREE])
    status = Status.CONVERGED if converged else Status.STEP_LIMIT
    return Solution(
        q=q,
        tip=tip,
        residual_m=float(np.linalg.norm(tip - problem.target)),
        iterations=iterations,
        status=status if reachable else Status.OUT_OF_REACH,
        converged=converged,
    )
