"""From a solver's name and a problem to its solution: what all solvers have in common before and after."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from armsight_control import own as own_parts
from armsight_control.chain import Array, Chain
from armsight_control.errors import SolverError
from armsight_control.folded import check_free, fold
from armsight_control.kinematics import Links, forward, links_of_report, need_report
from armsight_control.solvers import closed_form, own, redundant
from armsight_control.solvers.options import Options
from armsight_control.solvers.problem import REPORT_FREE, Found, Problem, Solution, Solutions, Status, Task
from armsight_control.solvers.workspace import Moving, nearest_reachable, reached

_JOINT_2 = 1
# By whether it converged (1) and whether the target is out of reach (2).
_STATUS = (Status.STEP_LIMIT, Status.CONVERGED, Status.UNREACHABLE, Status.UNREACHABLE)


def _closed_form(task: Task) -> Found:
    links, moving = _need("closed-form", task.chain), _moving(task)
    if moving is None:
        raise SolverError("the closed form needs joint 2 at 0 or free, and all other joints free")
    count = len(task.aims)
    if moving == "all four":
        q = redundant.solve(links, task.chain.limits, task.aims, task.starts, task.options.closed_form)
    elif count == 1:
        limits = closed_form.limits_of_report(task.chain)
        q = np.array([closed_form.solve_one(links, limits, task.aims[0].tolist(), task.free_starts[0].tolist())])
    else:
        q = closed_form.solve_batch(links, task.aims, task.free_starts)
    return Found(q, np.zeros(count, dtype=np.int64), np.ones(count, dtype=np.bool_))


def _gradient_descent(task: Task) -> Found:
    from armsight_control.solvers import gradient_descent  # takes seconds: it imports torch

    links = _need("gradient-descent", task.chain)
    if _moving(task) != "joint 2 at 0":
        raise SolverError("the report's descent needs joint 2 at 0 and all other joints free")
    limits = task.chain.limits[list(REPORT_FREE)]
    ends = [
        gradient_descent.descend(links, limits, aim, start, task.options.gradient_descent)
        for aim, start in zip(task.aims, task.free_starts, strict=True)
    ]
    q, iterations, met = zip(*ends, strict=True)
    return Found(np.array(q), np.array(iterations, dtype=np.int64), np.array(met, dtype=np.bool_))


def _torch(task: Task) -> Found:
    from armsight_control.solvers import torch_descent

    return torch_descent.solve(task)


def _levenberg_marquardt(task: Task) -> Found:
    from armsight_control.solvers import levenberg_marquardt

    return levenberg_marquardt.solve(task)


SOLVERS: dict[str, Callable[[Task], Found]] = {
    "torch": _torch,
    "gradient-descent": _gradient_descent,
    "levenberg-marquardt": _levenberg_marquardt,
    "closed-form": _closed_form,
}

_IN_THE_LOOP = frozenset({"closed-form"})

OF_THE_REPORT = frozenset({"gradient-descent", "closed-form"})
"""For an arm of its shape alone."""


def beside_the_loop(name: str) -> bool:
    """Whether a solver is too slow, or too slow to load, or too little known, for the process that answers frames."""
    return name not in _IN_THE_LOOP


def check_solver(name: str) -> None:
    """Refuses a name that no solver has; a solver of one's own (:mod:`.own`) is imported for it.

    Raises:
        SolverError: with the names that there are.
        OwnPartError: there is nothing to call at this place.
    """
    _function_of(name)


def _function_of(name: str) -> Callable[[Task], Found]:
    if own_parts.is_place(name):
        own_parts.load(name)
        return partial(own.solve, name)
    if name not in SOLVERS:
        raise SolverError(f"no solver {name!r}; there are {', '.join(SOLVERS)}")
    return SOLVERS[name]


def check_applies(name: str, chain: Chain) -> None:
    """Refuses a solver that is for another arm than this one.

    Raises:
        UnsupportedArmError: says what to use instead.
    """
    if name in OF_THE_REPORT:
        _need(name, chain)


def solve(name: str, problem: Problem) -> Solution:
    """Solves a problem.

    Raises:
        SolverError: no solver of that name, or the problem is not one that it solves.
        UnsupportedArmError: the solver is for the report's arm, and the chain is not of its shape.
    """
    target, start = np.asarray(problem.target)[None], np.asarray(problem.start)[None]
    return solve_batch(name, problem.chain, target, start, problem.free, problem.options)[0]


def solve_batch(
    name: str,
    chain: Chain,
    targets: Array,
    starts: Array,
    free: Sequence[int],
    options: Options | None = None,
) -> Solutions:
    """Solves many targets at once.

    Args:
        name: the solver.
        chain: the arm.
        targets: (m, 3), base frame, metres.
        starts: (m, n), all joints, radians; clamped to the limits.
        free: indices of the joints that may move; the others stay at the start's values.
        options: of all solvers.

    Raises:
        SolverError: no solver of that name, or the problem is not one that it solves.
        UnsupportedArmError: the solver is for the report's arm, and the chain is not of its shape.
    """
    check_solver(name)
    free = tuple(sorted(free))
    check_free(chain, free)
    targets, starts = _checked(chain, targets, starts)
    groups = _alike(starts, free)
    parts = [_solve_alike(name, chain, targets[rows], starts[rows], free, options or Options()) for rows in groups]
    return parts[0] if len(parts) == 1 else _joined(parts, np.concatenate(groups))


def _need(name: str, chain: Chain) -> Links:
    return need_report(chain, f"the solver {name}", "torch or levenberg-marquardt")


def _checked(chain: Chain, targets: Array, starts: Array) -> tuple[Array, Array]:
    targets, starts = np.asarray(targets, dtype=np.float64), np.asarray(starts, dtype=np.float64)
    if targets.ndim != 2 or targets.shape[1] != 3 or len(targets) == 0:
        raise SolverError(f"targets of shape {targets.shape}: expected (m, 3) with m of at least 1")
    if starts.shape != (len(targets), chain.count):
        raise SolverError(f"starts of shape {starts.shape}: expected ({len(targets)}, {chain.count})")
    if not math.isfinite(targets.sum() + starts.sum()):  # a tenth of the time of asking each number
        good = np.isfinite(targets).all(axis=1) & np.isfinite(starts).all(axis=1)
        if not good.all():
            raise SolverError(f"target {int(np.argmin(good))} or its start is not finite")
    return targets, chain.clip(starts)


def _alike(starts: Array, free: tuple[int, ...]) -> list[NDArray[np.int64]]:
    """Rows that hold the joints that may not move at the same angles."""
    if len(starts) == 1:
        return [np.arange(1)]
    held = starts[:, _held(starts.shape[1], free)]
    if (held == held[0]).all():
        return [np.arange(len(starts))]
    _, group = np.unique(held, axis=0, return_inverse=True)
    return [np.flatnonzero(group.ravel() == each) for each in range(group.max() + 1)]


def _held(count: int, free: tuple[int, ...]) -> list[int]:
    return [i for i in range(count) if i not in free]


def _solve_alike(
    name: str, chain: Chain, targets: Array, starts: Array, free: tuple[int, ...], options: Options
) -> Solutions:
    first = starts[0].tolist()
    folded = fold(chain, free, tuple(first[i] for i in _held(chain.count, free)))
    task = Task(chain, folded, targets, starts, options)
    aims, reachable = _aims(task)
    found = _function_of(name)(replace(task, aims=aims))
    q = starts.copy()
    q[:, free] = found.q
    q = chain.clip(q)
    tip = forward(chain, q[0])[None] if len(q) == 1 else folded.tips(q[:, free])
    beyond, converged = _outcome(found, reachable)
    return Solutions(
        q=q,
        tip=tip,
        residual_m=np.sqrt(((tip - targets) ** 2).sum(axis=1)),
        iterations=found.iterations,
        status=tuple(map(_STATUS.__getitem__, (converged + 2 * beyond).tolist())),
        converged=converged,
        note=found.note,
    )


def _outcome(found: Found, reachable: NDArray[np.bool_] | None) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which targets are out of reach, and for which the tip is where the solver meant to put it."""
    if reachable is not None:
        return ~reachable, found.met
    # where the reach is not known, what ends short of the target without a way nearer is at its edge
    beyond = ~found.met & (found.stationary if len(found.stationary) else False)
    return beyond, found.met | beyond


def _aims(task: Task) -> tuple[Array, NDArray[np.bool_] | None]:
    """Where the tip can go, and for which targets that is the target; nothing where the reach is not known."""
    moving = _moving(task)
    if moving is None:
        return task.aims, None
    links = links_of_report(task.chain)
    assert links is not None
    within = reached(links, task.aims, moving)
    if within.all():
        return task.aims, within
    aims = task.aims.copy()
    for i in np.flatnonzero(~within):
        x, y, _ = forward(task.chain, task.starts[i])
        aims[i], within[i] = nearest_reachable(links, task.aims[i], math.atan2(y, x), moving)
    return aims, within


def _moving(task: Task) -> Moving | None:
    """Which of the two sets of joints whose reach is known in closed form; none for other chains and sets."""
    if links_of_report(task.chain) is None:
        return None
    if len(task.folded.free) == task.chain.count:
        return "all four"
    return "joint 2 at 0" if task.folded.free == REPORT_FREE and task.starts[0, _JOINT_2] == 0 else None


def _joined(parts: Sequence[Solutions], order: NDArray[np.int64]) -> Solutions:
    """Parts that were solved apart, in the order of their targets."""
    back = np.argsort(order)
    status = [each for part in parts for each in part.status]
    return Solutions(
        q=np.concatenate([part.q for part in parts])[back],
        tip=np.concatenate([part.tip for part in parts])[back],
        residual_m=np.concatenate([part.residual_m for part in parts])[back],
        iterations=np.concatenate([part.iterations for part in parts])[back],
        status=tuple(status[i] for i in back),
        converged=np.concatenate([part.converged for part in parts])[back],
        note=next((part.note for part in parts if part.note), ""),
    )
