"""Levenberg-Marquardt, batched on torch: from the problem's start first, from others only where that did not arrive.

A restart breaks continuity, so a target that is followed never sees one as long as its own start reaches it. Where the
reach of a chain is not known, a start that ends where no motion brings the tip nearer is at the edge of it.
"""

import math
from copy import deepcopy
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray

from armsight_control.chain import Array
from armsight_control.folded import Folded
from armsight_control.solvers import edge as edge_of_reach
from armsight_control.solvers.blocks import DAMPED_STEPS
from armsight_control.solvers.options import LevenbergMarquardtOptions
from armsight_control.solvers.packages import Block, block
from armsight_control.solvers.problem import Found, Task
from armsight_control.solvers.start import spread

# Columns come in vectors of four; what does not fill one would be computed apart.
_LANES = 4
# Of the error's moment about a lever: below this share of it no motion brings the tip nearer.
_FLAT = 1e-5
# Nearest points that differ by less are equally near.
_AS_NEAR_M = 1e-6


@dataclass(frozen=True, slots=True)
class Ends:
    """Where columns ended."""

    u: Array
    """(columns, n)."""
    error_m: Array
    """(columns,)."""
    met: NDArray[np.bool_]
    stationary: NDArray[np.bool_]
    calls: NDArray[np.int64]
    """(columns,): of the block, until this column or another of its group arrived."""


def solve(task: Task) -> Found:
    """Solves a task."""
    options, folded = task.options.levenberg_marquardt, task.folded
    run = block("damped", len(folded.free), options.compile_on_demand)
    aims, own = folded.to_first(task.aims), task.free_starts + folded.offsets
    most = math.ceil(options.max_steps / DAMPED_STEPS)
    ends = refine(run, folded, aims, own, options.tolerance_m, options.damping, most)
    ends = restarted(run, folded, aims, own, ends, ~ends.met, options)
    ends = settled(task, ends, ~ends.met)
    met = ends.met | (ends.error_m <= options.tolerance_m)
    return Found(ends.u - folded.offsets, ends.calls * DAMPED_STEPS, met, ends.stationary & ~met, run.trouble)


def restarted(
    run: Block,
    folded: Folded,
    aims: Array,
    own: Array,
    ends: Ends,
    again: NDArray[np.bool_],
    options: LevenbergMarquardtOptions,
) -> Ends:
    """Tries some targets from other starts as well, and takes the best end of each.

    Args:
        run: the block.
        folded: the chain.
        aims: (m, 3), in the folded chain's first frame.
        own: (m, n), the problem's starts.
        ends: where these led.
        again: (m,), which targets to try.
        options: of the restarts.
    """
    left = np.flatnonzero(again)
    if not len(left) or not options.restarts:
        return ends
    starts = spread(folded, options.restarts, options.seed)
    count, tolerance_m = len(starts), options.tolerance_m
    others = refine(
        run,
        folded,
        np.repeat(aims[left], count, axis=0),
        np.tile(starts, (len(left), 1)),
        tolerance_m,
        options.damping,
        math.ceil(options.max_steps / DAMPED_STEPS),
        group=count,
    )
    best = deepcopy(ends)
    for k, row in enumerate(left):
        part = slice(k * count, (k + 1) * count)
        candidates = np.vstack([ends.u[row : row + 1], others.u[part]])
        errors = np.append(ends.error_m[row], others.error_m[part])
        chosen = nearest(candidates, errors, tolerance_m, own[row])
        best.u[row], best.error_m[row], best.met[row] = (
            candidates[chosen],
            errors[chosen],
            errors[chosen] <= tolerance_m,
        )
        best.stationary[row] = np.append(ends.stationary[row], others.stationary[part])[chosen]
        best.calls[row] += others.calls[part.start]
    return best


def settled(task: Task, ends: Ends, missed: NDArray[np.bool_]) -> Ends:
    """Brings to the edge of the reach what missed its aim, and is not yet where no motion brings it nearer.

    Args:
        task: what is solved.
        ends: so far.
        missed: (m,), which of them missed.

    Returns:
        The ends; which of them are at their aim now is left to whoever knows what that means.
    """
    left = np.flatnonzero(missed & ~ends.stationary)
    if not len(left):
        return ends
    folded, free = task.folded, list(task.folded.free)
    q = task.starts[left]
    q[:, free] = ends.u[left] - folded.offsets
    edge = edge_of_reach.nearest(task.chain, task.aims[left], task.chain.clip(q), task.folded.free, _flat_m(folded))
    best = deepcopy(ends)
    best.u[left], best.error_m[left] = edge.q[:, free] + folded.offsets, edge.error_m
    best.stationary[left] = edge.stationary
    return best


def _flat_m(folded: Folded) -> float:
    return float(_FLAT * folded.levers.max())


def nearest(candidates: Array, errors: Array, tolerance_m: float, start: Array) -> int:
    """Which of some ends to take: of those that are as near to the aim as any, the one nearest to the start."""
    good = errors <= max(tolerance_m, float(errors.min()) + (0.0 if errors.min() <= tolerance_m else _AS_NEAR_M))
    motion = np.where(good, ((candidates - start) ** 2).sum(axis=1), np.inf)
    return int(motion.argmin())


def refine(
    run: Block,
    folded: Folded,
    aims: Array,
    u: Array,
    tolerance_m: float,
    damping: float,
    most_calls: int,
    *,
    group: int = 1,
) -> Ends:
    """Iterates columns until each is at its aim or where no motion brings it nearer.

    Args:
        run: the block.
        folded: the chain.
        aims: (columns, 3), in the folded chain's first frame.
        u: (columns, n), where to begin.
        tolerance_m: what counts as at the aim.
        damping: to begin with, m²/rad².
        most_calls: of the block.
        group: so many columns in a row have one aim: it is enough that one of them arrives.
    """
    count = len(aims)
    fill = -count % _LANES
    target = _columns(aims, fill)
    state, damped = _columns(u, fill), torch.from_numpy(np.full(count + fill, damping))
    links, bounds, scalars = _constants(folded, tolerance_m)
    flat, enough = _flat_m(folded) ** 2, tolerance_m**2
    calls = np.zeros(count, dtype=np.int64)
    going = np.ones(count, dtype=np.bool_)
    while True:
        state, damped, squared, slope = run.call((state, damped, target, links, bounds, scalars))
        calls += going
        error2 = squared.numpy()[:count]
        met = error2 <= enough
        if met.all():
            return Ends(state.numpy()[:, :count].T.copy(), np.sqrt(error2), met, ~met, calls)
        stationary = ~met & (slope.numpy()[:count] <= flat * error2)
        over = met | stationary
        arrived = met.reshape(-1, group).any(axis=1) | over.reshape(-1, group).all(axis=1)
        going = ~np.repeat(arrived, group)
        if not going.any() or calls.max() >= most_calls:
            return Ends(state.numpy()[:, :count].T.copy(), np.sqrt(error2), met, stationary, calls)


@lru_cache(maxsize=64)
def _constants(folded: Folded, tolerance_m: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    scalars = torch.tensor([tolerance_m**2], dtype=torch.float64)
    return torch.from_numpy(folded.links), torch.from_numpy(folded.limits), scalars


def _columns(rows: Array, fill: int) -> torch.Tensor:
    """Rows as columns, the last one repeated to fill up."""
    columns = np.empty((rows.shape[1], len(rows) + fill))
    columns[:, : len(rows)] = rows.T
    columns[:, len(rows) :] = rows[-1, :, None]
    return torch.from_numpy(columns)
