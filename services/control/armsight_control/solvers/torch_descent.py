"""The default solver: the report's gradient descent made fit, on torch.

What the report's descent lacks is a way out of bad starts and slow valleys, and speed. Here many starts of a target
descend at once, as columns of one tensor, with momentum and a step size of each joint's own, in blocks of steps that
are compiled ahead of time; the first row of them is the problem's start. It ends as soon as every target is reached.
The descent alone meets a tolerance of millimetres; the last of them, where a descent crawls, are left to a few damped
Newton steps (the block of :mod:`~armsight_control.solvers.levenberg_marquardt`) on the one solution that was chosen:
the nearest to the start.

An answer should stay on its branch while a target is followed. So a start whose tip is near its target is waited for,
for a while, even when another start arrives first.

What no descent reaches is left to :mod:`~armsight_control.solvers.levenberg_marquardt` altogether: that solver knows
when no motion brings the tip nearer, which in chains whose reach is not known is the answer.
"""

import math
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray

from armsight_control.chain import Array
from armsight_control.folded import Folded
from armsight_control.solvers.blocks import DAMPED_STEPS, DESCENT_STEPS
from armsight_control.solvers.levenberg_marquardt import Ends, refine, restarted, settled
from armsight_control.solvers.options import TorchOptions
from armsight_control.solvers.packages import Block, block
from armsight_control.solvers.problem import Found, Task
from armsight_control.solvers.start import spread

# Starts per target in a batch, before the few targets that these don't reach get all of them.
_BATCH_STARTS, _BATCH_FROM = 16, 8
# What a start that is followed may take before another's solution is accepted.
_FOLLOW_STEPS = 200
# Of the last steps: from the descent's tolerance two calls are enough, at the edge of the reach it takes longer.
_POLISH_STEPS = 30
_POLISH_DAMPING = 1e-4
# A joint whose axis runs through the tip moves nothing, and needs no step.
_LEAST_LEVER_M = 1e-3


def solve(task: Task) -> Found:
    """Solves a task."""
    options, folded = task.options.torch, task.folded
    descent = block("descent", len(folded.free), options.compile_on_demand)
    damped = block("damped", len(folded.free), options.compile_on_demand)
    aims, own = folded.to_first(task.aims), task.free_starts + folded.offsets
    count = options.starts if len(aims) < _BATCH_FROM else min(options.starts, _BATCH_STARTS)
    u, met, calls = _descend(descent, folded, aims, own, count, options)
    if count < options.starts and not met.all():
        left = np.flatnonzero(~met)
        u[left], met[left], more = _descend(descent, folded, aims[left], own[left], options.starts, options)
        calls[left] += more
    ends = _polish(damped, folded, aims, u, options)
    missed = ends.error_m > options.accept_m
    ends = restarted(damped, folded, aims, own, ends, missed, task.options.levenberg_marquardt)
    ends = settled(task, ends, missed & (ends.error_m > options.accept_m))
    at_aim = ends.error_m <= options.accept_m
    return Found(
        q=ends.u - folded.offsets,
        iterations=calls * DESCENT_STEPS + ends.calls * DAMPED_STEPS,
        met=at_aim,
        stationary=ends.stationary & ~at_aim,
        note=descent.trouble or damped.trouble,
    )


def _descend(
    run: Block, folded: Folded, aims: Array, own: Array, count: int, options: TorchOptions
) -> tuple[Array, NDArray[np.bool_], NDArray[np.int64]]:
    """Descends from ``count`` starts of each of m targets.

    Returns:
        Of each target the chosen u (m, n), whether it is within the descent's tolerance (m,), and the calls it took.
    """
    m, n = own.shape
    constants = _constants(folded, options)
    tolerance2 = np.float32(options.descent_m**2)
    begin = np.empty((n, m, count), dtype=np.float32)
    begin[:, :, 0] = own.T
    begin[:, :, 1:] = spread(folded, count - 1, options.seed).T[:, None]
    u = torch.from_numpy(begin.reshape(n, m * count))
    v = torch.from_numpy(np.zeros((n, m * count), dtype=np.float32))
    target = torch.from_numpy(np.repeat(aims.T.astype(np.float32), count, axis=1))
    best, met, calls = own.copy(), np.zeros(m, dtype=np.bool_), np.zeros(m, dtype=np.int64)
    rows, followed = np.arange(m), np.zeros(m, dtype=np.bool_)
    for call in range(1, math.ceil(options.max_steps / DESCENT_STEPS) + 1):
        u, v, squared = run.call((u, v, target, *constants))
        error2 = squared.numpy().reshape(-1, count)
        if call == 1:
            followed = np.asarray(error2[:, 0] < options.follow_m**2)
        last = call * DESCENT_STEPS >= options.max_steps
        if error2.min() >= tolerance2 and not last:
            continue
        there = error2 < tolerance2
        arrived = np.asarray(there.any(axis=1))
        if call * DESCENT_STEPS < _FOLLOW_STEPS:
            arrived = arrived & (there[:, 0] | ~followed)
        over = np.ones_like(arrived) if last else arrived
        ended = rows[over]
        if not len(ended):
            continue
        angles = u.numpy().reshape(n, -1, count)
        best[ended] = _chosen(angles[:, over], there[over], error2[over], own[ended])
        met[ended], calls[ended] = arrived[over], call
        if len(ended) == len(rows):
            break
        rows, followed = rows[~over], followed[~over]
        keep = torch.from_numpy(np.repeat(~over, count))
        u, v, target = u[:, keep], v[:, keep], target[:, keep]
    return best, met, calls


@lru_cache(maxsize=64)
def _constants(folded: Folded, options: TorchOptions) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Links, bounds with step sizes, and scalars, as the block takes them."""
    steps = options.step / (len(folded.free) * np.maximum(folded.levers, _LEAST_LEVER_M) ** 2)
    bounds = np.column_stack([folded.limits, steps]).astype(np.float32)
    scalars = torch.tensor([options.momentum, options.descent_m**2], dtype=torch.float32)
    return torch.from_numpy(folded.links.astype(np.float32)), torch.from_numpy(bounds), scalars


def _chosen(angles: Array, there: NDArray[np.bool_], error2: Array, own: Array) -> Array:
    """Of each target the start that arrived nearest to the problem's own, or came nearest to the aim: (m, n)."""
    motion = ((angles - own.T[:, :, None]) ** 2).sum(axis=0)
    score = np.where(there, motion, 1e6 * (1 + error2))
    return np.asarray(angles[:, np.arange(len(own)), score.argmin(axis=1)].T, dtype=np.float64)


def _polish(run: Block, folded: Folded, aims: Array, u: Array, options: TorchOptions) -> Ends:
    u = np.clip(u, folded.limits[:, 0], folded.limits[:, 1])
    most = math.ceil(_POLISH_STEPS / DAMPED_STEPS)
    return refine(run, folded, aims, u, options.tolerance_m, _POLISH_DAMPING, most)
