r"""What the report's arm reaches with joint 2 at 0, in closed form.

In the half-plane through the z-axis, with rho the distance from that axis and h the height over the shoulder, the
region is bounded by three arcs and a segment:

- stretched, psi = 0: radius L3 + L4 round the shoulder;
- folded, |psi| = pi/2: radius sqrt(L3² + L4²) round the shoulder;
- upright, phi = 0: radius L4 round (0, L3), which leaves a hollow round the z-axis;
- level, |phi| = pi/2: h = 0.
"""

import math

import numpy as np

from armsight_control.chain import Array
from armsight_control.kinematics import Links

# Rounding of coordinates of some ten metres: what is this near counts as reached.
TOLERANCE_M = 1e-9


def nearest_reachable(links: Links, target: Array, azimuth: float) -> tuple[Array, bool]:
    """The reachable point nearest to a target, and whether that is the target itself.

    Args:
        links: the lengths.
        target: base frame, metres.
        azimuth: where to turn to for a target on the z-axis, which lies equally near to points all round it.
    """
    rho, h = math.hypot(target[0], target[1]), float(target[2]) - links.l1
    if _reaches(links, rho, h):
        return target, True
    near_rho, near_h = _nearest(links, rho, h)
    if math.hypot(near_rho - rho, near_h - h) <= TOLERANCE_M:
        return target, True
    x, y = (target[0] / rho, target[1] / rho) if rho > TOLERANCE_M else (math.cos(azimuth), math.sin(azimuth))
    return np.array([near_rho * x, near_rho * y, near_h + links.l1]), False


def cos_psi(links: Links, rho: float, h: float) -> float:
    """Cosine of psi that puts the tip at this distance from the shoulder; beyond [0, 1] where none does."""
    return (rho * rho + h * h - links.l3**2 - links.l4**2) / (2 * links.l3 * links.l4)


def _reaches(links: Links, rho: float, h: float) -> bool:
    c = cos_psi(links, rho, h)
    return 0 <= c <= 1 and h >= 0 and rho * rho >= links.l4**2 * (1 - c * c)


def _nearest(links: Links, rho: float, h: float) -> tuple[float, float]:
    quarter = math.pi / 2
    outer, inner = links.l3 + links.l4, math.hypot(links.l3, links.l4)
    stretched = math.atan2(rho, max(h, 0.0)) if rho > 0 or h > 0 else 0.0
    folded = min(max(stretched, math.atan2(links.l4, links.l3)), quarter)
    upright = min(max(math.atan2(rho, h - links.l3), 0.0), quarter)
    candidates = (
        (outer * math.sin(stretched), outer * math.cos(stretched)),
        (inner * math.sin(folded), inner * math.cos(folded)),
        (links.l4 * math.sin(upright), links.l3 + links.l4 * math.cos(upright)),
        (min(max(rho, inner), outer), 0.0),
    )
    return min(candidates, key=lambda point: math.hypot(point[0] - rho, point[1] - h))
