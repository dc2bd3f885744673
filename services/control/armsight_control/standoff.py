"""Where the tip is to be to follow a sphere: beside it, never in it, on the line through its centre and the shoulder.

A tip that reaches the sphere hides its own marker behind it. There are two such places. The one between shoulder and
sphere is preferred, but the report's arm can't fold to less than 4.25 m and the sphere of the scene goes round at 2.8
to 4.4 m from the shoulder: that place is at 1.8 to 3.4 m and never reached. The one beyond the sphere, at 3.8 to 5.4 m,
is the only one that this arm can be at, wherever that is 4.25 m or more.
"""

from collections.abc import Callable

import numpy as np

from armsight_control.aiming import NEAR_M
from armsight_control.chain import Array
from armsight_control.tracking import Moving

DISTANCE_M = 1.0
"""From the sphere's centre, where nothing else is said."""

BEFORE, BEYOND = -1, 1
"""Sides of the sphere, as signs along the line from the shoulder."""

_DIFFERENCE_S = 0.01
# Where neither side is reached, the other one is taken if the tip gets nearer to it by this much: no to and fro.
_BETTER_M = 0.1


def beside(centre: Moving, shoulder: Array, distance_m: float, side: int) -> Moving:
    """The point on one side of the sphere, in motion with it."""
    now = _point(centre.position, shoulder, distance_m, side)
    later = _point(centre.position + _DIFFERENCE_S * centre.velocity, shoulder, distance_m, side)
    return Moving(now, (later - now) / _DIFFERENCE_S)


def side_of(
    centre: Array, shoulder: Array, distance_m: float, present: int | None, missed_m: Callable[[Array], float]
) -> int:
    """The side to be on: the present one as long as it is reached, else the one that the tip gets nearer to.

    Args:
        centre: of the sphere, base frame.
        shoulder: base frame.
        distance_m: from the centre to the point.
        present: side, if one was chosen; before the sphere is preferred without.
        missed_m: how far the tip stays from a point.
    """
    first = BEFORE if present is None else present
    missed = missed_m(_point(centre, shoulder, distance_m, first))
    if missed < NEAR_M:
        return first
    other = missed_m(_point(centre, shoulder, distance_m, -first))
    return -first if other < max(NEAR_M, missed - _BETTER_M) else first


def _point(centre: Array, shoulder: Array, distance_m: float, side: int) -> Array:
    line = centre - shoulder
    length = float(np.linalg.norm(line))
    along = line / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    return np.asarray(centre + side * distance_m * along)
