"""A solver of a person's own, ``--solver module:function``, held to what ours are held to.

It is called for one target at a time::

    def solve(chain: Chain, target: Array, start: Array, free: tuple[int, ...]) -> Array: ...

``target`` (3,) is in the base frame in metres, and where the reach is known already moved to where the tip can go;
``start`` (n,) are all joints in radians; ``free`` are the indices of those that may move. It gives back all joints,
(n,).
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from armsight_control import own
from armsight_control.chain import Array
from armsight_control.errors import SolverError
from armsight_control.kinematics import forward
from armsight_control.solvers.problem import Found, Task

AT_TARGET_M = 0.005
"""What a solution is judged by, as everywhere."""


def solve(place: str, task: Task) -> Found:
    """Solves a task, target by target.

    Raises:
        SolverError: the solver failed, or what it gave back is no configuration of this arm.
        OwnPartError: there is no such solver.
    """
    function, free = own.load(place), task.folded.free
    q = np.array([_one(place, function, task, aim, start) for aim, start in zip(task.aims, task.starts, strict=True)])
    off = np.array([np.linalg.norm(forward(task.chain, row) - aim) for row, aim in zip(q, task.aims, strict=True)])
    return Found(q[:, free], np.zeros(len(q), dtype=np.int64), off <= AT_TARGET_M)


def _one(place: str, function: Callable[..., Any], task: Task, aim: Array, start: Array) -> Array:
    try:
        # a copy: what others' arrays lend may be read only
        answer = np.array(function(task.chain, aim.copy(), start.copy(), task.folded.free), dtype=np.float64)
    except Exception as error:  # somebody else's code: anything can go wrong in it
        raise SolverError(f"the solver {place} failed: {type(error).__name__}: {error}") from error
    if answer.shape != start.shape or not np.isfinite(answer).all():
        raise SolverError(
            f"the solver {place} gave back {_shown(answer)}: expected {len(start)} finite angles, one for each joint"
        )
    held = [i for i in range(len(start)) if i not in task.folded.free]
    answer[held] = start[held]
    return task.chain.clip(answer)


def _shown(answer: Array) -> str:
    return f"shape {answer.shape}" if answer.ndim != 1 else np.array2string(answer, precision=3, threshold=8)
