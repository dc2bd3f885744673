r"""To the edge of the reach: Newton's method within limits, for targets that no motion brings the tip to.

Gauss-Newton takes :math:`J^T J` for the second derivative of :math:`\tfrac12 \|p(q) - target\|^2`. Where the target
stays far away, what it leaves out is larger than what it keeps, and steps crawl. Here nothing is left out:

.. math:: H_{ij} = J_i \cdot J_j + (p - target) \cdot (a_i \times J_j), \qquad i \le j

with a the joints' axes. Directions in which H curves downwards are taken with the opposite sign, so that each step goes
down; a joint at a limit that would leave it stays; only steps that bring the tip nearer are taken.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight_control.chain import Array, Chain
from armsight_control.kinematics import frames, jacobian

# From where damped Gauss-Newton ends it takes five to ten.
_MOST_STEPS = 60
_TRUST, _DISTRUST = 0.1, 8.0
# Of H's largest eigenvalue: what a direction curves at least, so that a flat one makes no endless step.
_LEAST_CURVE = 1e-9
_LONGEST_RAD = 1.0


@dataclass(frozen=True, slots=True)
class Edge:
    """Where configurations ended."""

    q: Array
    """(m, n), all joints."""
    error_m: Array
    """(m,): of tip and target."""
    stationary: NDArray[np.bool_]
    """(m,): within the limits no motion brings the tip nearer."""


def nearest(chain: Chain, targets: Array, q: Array, free: tuple[int, ...], flat_m: float) -> Edge:
    """Brings tips as near to their targets as their surroundings allow.

    Args:
        chain: the arm.
        targets: (m, 3), base frame, metres.
        q: (m, n), all joints, inside the limits: where to begin.
        free: indices of the joints that may move.
        flat_m: what counts as no way nearer: the error's moment about the joints, as a share of the error.
    """
    q, moving = q.copy(), list(free)
    lower, upper = chain.limits[moving].T
    damping, stationary = np.zeros(len(q)), np.zeros(len(q), dtype=np.bool_)
    error, gradient, curve = derivatives(chain, targets, q, moving)
    for _ in range(_MOST_STEPS):
        x = q[:, moving]
        held = ((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0))
        slope = np.where(held, 0.0, gradient)
        stationary = np.linalg.norm(slope, axis=1) <= flat_m * error
        going = np.flatnonzero(~stationary)
        if not len(going):
            break
        step = _step(curve[going], slope[going], held[going], damping[going])
        tried = q[going]
        tried[:, moving] = np.clip(x[going] + step, lower, upper)
        new_error, new_gradient, new_curve = derivatives(chain, targets[going], tried, moving)
        nearer = new_error < error[going]
        largest = np.abs(np.einsum("mii->mi", curve[going])).max(axis=1)
        damping[going] = np.where(
            nearer, damping[going] * _TRUST, np.maximum(damping[going], 1e-3 * largest) * _DISTRUST
        )
        taken = going[nearer]
        q[taken], error[taken] = tried[nearer], new_error[nearer]
        gradient[taken], curve[taken] = new_gradient[nearer], new_curve[nearer]
    return Edge(q, error, stationary)


def derivatives(chain: Chain, targets: Array, q: Array, moving: list[int]) -> tuple[Array, Array, Array]:
    """Error (m,), and gradient (m, k) and Hessian (m, k, k) of half its square."""
    rotations, origins = frames(chain, q)
    tip = origins[:, chain.tip.joint + 1] + rotations[:, chain.tip.joint + 1] @ chain.tip.position
    columns = np.swapaxes(jacobian(chain, q), 1, 2)[:, moving]
    axes = np.einsum("mnij,nj->mni", rotations[:, 1:], chain.axes)[:, moving]
    off = tip - targets
    # a_i x J_j for i <= j; the other half is its mirror
    bend = np.einsum("mk,mijk->mij", off, np.cross(axes[:, :, None], columns[:, None]))
    upper = np.triu(bend)
    bend = upper + np.swapaxes(np.triu(upper, 1), 1, 2)
    return (
        np.linalg.norm(off, axis=1),
        np.einsum("mik,mk->mi", columns, off),
        np.einsum("mik,mjk->mij", columns, columns) + bend,
    )


def _step(curve: Array, slope: Array, held: NDArray[np.bool_], damping: Array) -> Array:
    """Newton's step (m, k) of the joints that are not held."""
    apart = held[:, :, None] | held[:, None, :]
    curve = np.where(apart, np.eye(slope.shape[1]), curve)
    values, vectors = np.linalg.eigh(curve)
    values = np.abs(values)
    values = np.maximum(values, _LEAST_CURVE * values.max(axis=1, keepdims=True)) + damping[:, None]
    step = -np.einsum("mij,mj->mi", vectors, np.einsum("mji,mj->mi", vectors, slope) / values)
    step = np.where(held, 0.0, step)
    longest = np.abs(step).max(axis=1, keepdims=True)
    return np.asarray(step * np.minimum(1.0, _LONGEST_RAD / np.maximum(longest, _LONGEST_RAD)))
