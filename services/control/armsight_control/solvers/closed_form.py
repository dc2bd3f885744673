r"""Exact inverse kinematics of the report's arm with joint 2 at 0: all branches first, then filters.

With h the height of the target over the shoulder and rho its distance from the z-axis, :math:`r_3 \cdot r_4 = \cos\psi`
fixes psi up to its sign, :math:`h = c_\phi (L_3 + L_4 c_\psi)` phi up to its sign, and theta is what turns the tip to
the target's azimuth: four solutions, which lie within the limits for every reachable target.

One target is solved in plain floats, which takes microseconds; batches in numpy. With joint 2 free:
:mod:`~armsight_control.solvers.redundant`.
"""

import math
from collections.abc import Iterable, Sequence
from functools import lru_cache

import numpy as np

from armsight_control.chain import Array, Chain
from armsight_control.kinematics import Links
from armsight_control.solvers.problem import REPORT_FREE
from armsight_control.solvers.workspace import TOLERANCE_M

Angles = tuple[float, float, float]
"""Theta, phi, psi."""

_TURN = 2 * math.pi
# A solution this little outside of a limit is rounding, and is clamped.
ROUNDING_RAD = 1e-9


def branches(links: Links, target: Sequence[float], theta_on_axis: float) -> list[Angles]:
    """All four solutions for a reachable target.

    Args:
        links: the lengths.
        target: base frame, metres; see :func:`~armsight_control.solvers.workspace.nearest_reachable`.
        theta_on_axis: theta for a target on the z-axis, where any is right.
    """
    x, y, h = target[0], target[1], target[2] - links.l1
    l3, l4 = links.l3, links.l4
    rho = math.hypot(x, y)
    c = min(1.0, max(0.0, (rho * rho + h * h - l3 * l3 - l4 * l4) / (2 * l3 * l4)))
    across = l4 * math.sqrt(1 - c * c)
    level = math.sqrt(max(0.0, rho * rho - across * across))
    psi, phi = math.atan2(across, l4 * c), math.atan2(level, max(0.0, h))
    if rho <= TOLERANCE_M:
        theta = math.remainder(theta_on_axis, _TURN)
        return [(theta, phi, psi), (theta, -phi, psi), (theta, phi, -psi), (theta, -phi, -psi)]
    # before theta turns it, the tip lies at (across, -level) with the signs of psi and phi
    azimuth, turned = math.atan2(y, x), math.atan2(level, across)
    other = math.pi - turned
    return [
        (math.remainder(azimuth + turned, _TURN), phi, psi),
        (math.remainder(azimuth - turned, _TURN), -phi, psi),
        (math.remainder(azimuth + other, _TURN), phi, -psi),
        (math.remainder(azimuth - other, _TURN), -phi, -psi),
    ]


def within_limits(solutions: Iterable[Angles], limits: Sequence[Sequence[float]]) -> list[Angles]:
    """Those of some solutions that lie within the limits of theta, phi and psi, rounding aside."""
    (a, b), (c, d), (e, f) = limits
    a, c, e, b, d, f = (
        a - ROUNDING_RAD,
        c - ROUNDING_RAD,
        e - ROUNDING_RAD,
        b + ROUNDING_RAD,
        d + ROUNDING_RAD,
        f + ROUNDING_RAD,
    )
    return [s for s in solutions if a <= s[0] <= b and c <= s[1] <= d and e <= s[2] <= f]


def nearest_to(solutions: Iterable[Angles], start: Sequence[float]) -> Angles:
    """The solution with the least motion from a configuration of the same three joints.

    Raises:
        ValueError: there are none.
    """
    a, b, c = start
    return min(solutions, key=lambda s: (s[0] - a) * (s[0] - a) + (s[1] - b) * (s[1] - b) + (s[2] - c) * (s[2] - c))


@lru_cache(maxsize=16)
def limits_of_report(chain: Chain) -> list[list[float]]:
    """Of theta, phi and psi, in plain floats; not to be changed."""
    limits: list[list[float]] = chain.limits[list(REPORT_FREE)].tolist()
    return limits


def solve_one(
    links: Links, limits: Sequence[Sequence[float]], target: Sequence[float], start: Sequence[float]
) -> Angles:
    """The solution within the limits that is nearest to a configuration; arguments as of the three steps.

    Raises:
        ValueError: the target is not reachable.
    """
    return nearest_to(within_limits(branches(links, target, start[0]), limits), start)


def solve_batch(links: Links, targets: Array, starts: Array) -> Array:
    """The nearest solutions (m, 3) for reachable targets (m, 3) and starts (m, 3), all within the report's limits."""
    x, y, h = targets[:, 0], targets[:, 1], targets[:, 2] - links.l1
    squared = x * x + y * y
    rho = np.sqrt(squared)
    c = np.clip((squared + h * h - links.l3**2 - links.l4**2) / (2 * links.l3 * links.l4), 0.0, 1.0)
    across = links.l4 * np.sqrt(1 - c * c)
    level = np.sqrt(np.maximum(0.0, squared - across * across))
    off_axis = rho > TOLERANCE_M
    psi, phi = np.arctan2(across, links.l4 * c), np.arctan2(level, np.maximum(0.0, h))
    azimuth = np.where(off_axis, np.arctan2(y, x), starts[:, 0])
    turned = np.where(off_axis, np.arctan2(level, across), 0.0)
    other = np.where(off_axis, math.pi - turned, 0.0)
    theta = np.stack([azimuth + turned, azimuth - turned, azimuth + other, azimuth - other])
    theta -= _TURN * np.round(theta / _TURN)
    phis, psis = np.stack([phi, -phi, phi, -phi]), np.stack([psi, psi, -psi, -psi])
    motion = (theta - starts[:, 0]) ** 2 + (phis - starts[:, 1]) ** 2 + (psis - starts[:, 2]) ** 2
    best, each = motion.argmin(axis=0), np.arange(len(targets))
    return np.stack([theta[best, each], phis[best, each], psis[best, each]], axis=1)
