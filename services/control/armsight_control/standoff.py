"""Where the tip is to be to follow a sphere: beside it, never in it, on the line through its centre and the shoulder.

A tip that reaches the sphere hides its own marker behind it. Between shoulder and sphere is the better place; the arm
can't fold to less than 4.25 m, so that for a sphere nearer than 5.25 m only the place beyond it can be reached.
"""

from collections.abc import Callable

import numpy as np

from armsight_control.chain import Array
from armsight_control.tracking import Moving

DISTANCE_M = 1.0

BEFORE, BEYOND = -1, 1
"""Sides of the sphere, as signs along the line from the shoulder."""

_DIFFERENCE_S = 0.01


def beside(centre: Moving, shoulder: Array, side: int) -> Moving:
    """The point on one side of the sphere, in motion with it."""
    now = _point(centre.position, shoulder, side)
    later = _point(centre.position + _DIFFERENCE_S * centre.velocity, shoulder, side)
    return Moving(now, (later - now) / _DIFFERENCE_S)


def side_of(centre: Array, shoulder: Array, present: int | None, reachable: Callable[[Array], bool]) -> int:
    """The side to be on: the present one as long as it can be reached, else the other, before the sphere by preference.

    Args:
        centre: of the sphere, base frame.
        shoulder: base frame.
        present: side, if one was chosen.
        reachable: whether the tip can be at a point.
    """
    first = BEFORE if present is None else present
    for side in (first, -first):
        if reachable(_point(centre, shoulder, side)):
            return side
    return first


def _point(centre: Array, shoulder: Array, side: int) -> Array:
    line = centre - shoulder
    length = float(np.linalg.norm(line))
    along = line / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    return np.asarray(centre + side * DISTANCE_M * along)
