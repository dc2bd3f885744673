r"""What the report's arm reaches, in closed form: with joint 2 at 0, and with all four joints.

In the half-plane through the z-axis, with rho the distance from that axis and h the height over the shoulder, both
regions lie between two arcs round the shoulder: stretched, psi = 0, with radius L3 + L4, and folded, |psi| = pi/2, with
radius sqrt(L3² + L4²). With joint 2 at 0 two more edges bound it:

- upright, phi = 0: an arc of radius L4 round (0, L3), which leaves a hollow round the z-axis;
- level, |phi| = pi/2: h = 0.

With all four joints there is no hollow, and below h = 0 the region ends at an arc of radius L4 round (L3, 0): the
elbow cannot go below the shoulder, and link 4 hangs from it.
"""

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from armsight_control.chain import Array, Triple
from armsight_control.kinematics import Links

Moving = Literal["joint 2 at 0", "all four"]

# Rounding of coordinates of some ten metres: what is this near counts as reached.
TOLERANCE_M = 1e-9


def nearest_reachable(
    links: Links, target: Array, azimuth: float, moving: Moving = "joint 2 at 0"
) -> tuple[Array, bool]:
    """The reachable point nearest to a target, and whether that is the target itself.

    Args:
        links: the lengths.
        target: base frame, metres.
        azimuth: where to turn to for a target on the z-axis, which lies equally near to points all round it.
        moving: which joints may move.
    """
    x, y, z = target.tolist()
    near = nearest_point(links, (x, y, z), azimuth, moving)
    return (target, True) if near is None else (np.array(near), False)


def nearest_point(links: Links, target: Triple, azimuth: float, moving: Moving = "joint 2 at 0") -> Triple | None:
    """As :func:`nearest_reachable`, in plain floats; nothing where the target itself is reached."""
    x, y, z = target
    rho, h = math.hypot(x, y), z - links.l1
    if reaches(links, rho, h, moving):
        return None
    near_rho, near_h = _nearest(links, rho, h, moving)
    if math.hypot(near_rho - rho, near_h - h) <= TOLERANCE_M:
        return None
    x, y = (x / rho, y / rho) if rho > TOLERANCE_M else (math.cos(azimuth), math.sin(azimuth))
    return near_rho * x, near_rho * y, near_h + links.l1


def reached(links: Links, targets: Array, moving: Moving) -> NDArray[np.bool_]:
    """Which of some targets (m, 3) can be reached, rounding aside."""
    if len(targets) == 1:  # in plain floats, ten times faster
        x, y, z = targets[0].tolist()
        return np.array([reaches(links, math.hypot(x, y), z - links.l1, moving)])
    rho, h = np.hypot(targets[:, 0], targets[:, 1]), targets[:, 2] - links.l1
    return np.asarray(reaches(links, rho, h, moving))


def reaches(links: Links, rho: Array | float, h: Array | float, moving: Moving) -> NDArray[np.bool_] | bool:
    """Whether points of the half-plane lie in the region: floats, or arrays of one shape."""
    c = (rho * rho + h * h - links.l3**2 - links.l4**2) / (2 * links.l3 * links.l4)
    between = (c >= 0) & (c <= 1)
    if moving == "all four":
        return between & ((h >= 0) | ((rho - links.l3) ** 2 + h * h <= links.l4**2))
    return between & (h >= 0) & (rho * rho >= links.l4**2 * (1 - c * c))


def _nearest(links: Links, rho: float, h: float, moving: Moving) -> tuple[float, float]:
    quarter = math.pi / 2
    outer, inner = links.l3 + links.l4, math.hypot(links.l3, links.l4)
    if moving == "all four":
        downwards = math.atan2(rho, h) if rho > 0 or h != 0 else 0.0
        stretched, folded = min(downwards, quarter), min(downwards, math.atan2(links.l3, -links.l4))
        under = math.atan2(rho - links.l3, h)
        hanging = quarter if h >= 0 else math.pi if under < 0 else max(under, quarter)
        candidates = [
            (outer * math.sin(stretched), outer * math.cos(stretched)),
            (inner * math.sin(folded), inner * math.cos(folded)),
            (links.l3 + links.l4 * math.sin(hanging), links.l4 * math.cos(hanging)),
        ]
    else:
        stretched = math.atan2(rho, max(h, 0.0)) if rho > 0 or h > 0 else 0.0
        folded = min(max(stretched, math.atan2(links.l4, links.l3)), quarter)
        upright = min(max(math.atan2(rho, h - links.l3), 0.0), quarter)
        candidates = [
            (outer * math.sin(stretched), outer * math.cos(stretched)),
            (inner * math.sin(folded), inner * math.cos(folded)),
            (links.l4 * math.sin(upright), links.l3 + links.l4 * math.cos(upright)),
            (min(max(rho, inner), outer), 0.0),
        ]
    return min(candidates, key=lambda point: math.hypot(point[0] - rho, point[1] - h))
