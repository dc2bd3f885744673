r"""From the point where the tip is to be to the configuration that puts it there, on the branch that the arm is on.

The solver beside the loop chooses the branch and says what can be reached; it may be late, and is as exact as its
tolerance. Between its answers a configuration is carried on to the point of this very instant: with joint 2 at 0 by the
closed form, which takes microseconds and stays exact on the edge of the workspace; with all four joints free by
Gauss-Newton steps with the damped Jacobian and what the null space leaves.
"""

import math
from dataclasses import dataclass

import numpy as np

from armsight_control.chain import Array, Chain, farthest
from armsight_control.kinematics import Links, forward, jacobian, links_of_report
from armsight_control.nullspace import DAMPING_M, damped_inverse, null_motion
from armsight_control.solvers import REPORT_FREE
from armsight_control.solvers.closed_form import limits_of_report, solve_one
from armsight_control.solvers.start import for_free
from armsight_control.solvers.workspace import TOLERANCE_M, nearest_point
from armsight_control.tracking import Moving

FREE_JOINTS = {"3": REPORT_FREE, "all": (0, 1, 2, 3)}
"""Of the report's arm, by what is chosen; every other arm moves all its joints: :func:`free_of`."""

NEAR_M = 1e-4
"""The tip is there: a tenth of what vision can tell."""

# A jump of a joint from one instant to the next that no motion of the target explains is another branch.
BRANCH_RAD = 0.5
_STEPS = 8
_LARGEST_STEP_RAD = 0.2
_DIFFERENCE_S = 0.01


@dataclass(frozen=True, slots=True)
class Aim:
    """Where the arm is to be, and how fast that moves."""

    q: Array
    velocity: Array
    tip: Array
    """Of that configuration: the point asked for, or the nearest that is reached."""
    reachable: bool
    """Whether the tip gets to the point asked for."""


def free_of(chain: Chain, choice: str) -> tuple[int, ...]:
    """The joints that may move for a target, by a key of :data:`FREE_JOINTS`."""
    return FREE_JOINTS[choice] if links_of_report(chain) is not None else tuple(range(chain.count))


def aim(chain: Chain, free: tuple[int, ...], point: Moving, start: Array, dt_s: float) -> Aim:
    r"""The configuration for a point in motion, near another configuration.

    The joints' velocity is the difference to where the point will be a little later: this is :math:`J^{-1} \dot x`
    where the point is reached, and along the edge of the workspace where it is not.

    Args:
        chain: the arm.
        free: joints that may move; :func:`free_of`.
        point: base frame, metres and metres per second.
        start: the configuration to stay near to, all joints.
        dt_s: since that was aimed at: how long the null space may be used.

    Raises:
        UnsupportedArmError: joint 2 is to stay at 0, and the arm is not of the report's shape.
    """
    drift = np.zeros(chain.count)
    if len(free) > len(point.position):
        columns = list(free)
        drift[columns] = null_motion(chain, start, jacobian(chain, start)[:, columns], free)
    q, missed_m = carried(chain, free, point.position, start + drift * dt_s)
    later, _ = carried(chain, free, point.position + point.velocity * _DIFFERENCE_S, q)
    change = later - q
    # across a branch there is no velocity: the arm is on its way for longer than an instant
    velocity = change / _DIFFERENCE_S + drift if farthest(later, q) < BRANCH_RAD / 2 else np.zeros(chain.count)
    return Aim(q, velocity, forward(chain, q), missed_m < NEAR_M)


def carried(chain: Chain, free: tuple[int, ...], point: Array, start: Array) -> tuple[Array, float]:
    """A configuration near ``start`` with the tip at a point, or as near to it as it gets; and how far off that is."""
    links = links_of_report(chain)
    if free == REPORT_FREE and links is not None:
        return _by_closed_form(chain, links, point, start)
    q = chain.clip(start)
    columns = list(free)
    error = point - forward(chain, q)
    for _ in range(_STEPS):
        off = math.hypot(*error.tolist())
        if off < NEAR_M / 10:
            break
        step = damped_inverse(jacobian(chain, q)[:, columns], DAMPING_M * chain.scale) @ error
        step *= min(1.0, _LARGEST_STEP_RAD / max(float(np.abs(step).max()), 1e-12))
        better = False
        for share in (1.0, 0.5, 0.1):  # a full step beyond the edge of the workspace leads away
            tried = q.copy()
            tried[columns] += share * step
            tried = chain.clip(tried)
            missed = point - forward(chain, tried)
            if math.hypot(*missed.tolist()) < off:
                q, error, better = tried, missed, True
                break
        if not better:
            break
    return q, math.hypot(*error.tolist())


def _by_closed_form(chain: Chain, links: Links, point: Array, start: Array) -> tuple[Array, float]:
    """What the solver of that name finds, without what all solvers have around them: twice for every frame."""
    x, y, z = point.tolist()
    q = for_free(chain, start, REPORT_FREE)
    azimuth = 0.0
    if math.hypot(x, y) <= TOLERANCE_M:  # only on the z-axis is it asked for
        ahead, aside, _ = forward(chain, q).tolist()
        azimuth = math.atan2(aside, ahead)
    near = nearest_point(links, (x, y, z), azimuth) or (x, y, z)
    angles = q.tolist()
    found = solve_one(links, limits_of_report(chain), near, [angles[i] for i in REPORT_FREE])
    for i, angle in zip(REPORT_FREE, found, strict=True):
        angles[i] = angle
    return chain.clip(np.array(angles)), math.dist(near, (x, y, z))
