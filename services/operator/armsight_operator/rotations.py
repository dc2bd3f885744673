"""Rotations as unit quaternions, w first: what matrices, axes and directions become on the bus and in browsers."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Wxyz = tuple[float, float, float, float]


def about(axis: Sequence[float], angle_rad: float) -> Wxyz:
    """The rotation about a unit vector."""
    half = angle_rad / 2
    x, y, z = (math.sin(half) * part for part in axis)
    return math.cos(half), x, y, z


def from_z_to(direction: Sequence[float]) -> Wxyz:
    """The shortest turn of the z axis onto a direction of any length; none for no direction."""
    x, y, z = (float(part) for part in direction)
    length = math.hypot(x, y, z)
    if length == 0.0:
        return 1.0, 0.0, 0.0, 0.0
    w = 1.0 + z / length
    if w < 1e-9:  # against the axis: half a turn about x
        return 0.0, 1.0, 0.0, 0.0
    norm = math.hypot(w, x / length, y / length)
    return w / norm, -y / length / norm, x / length / norm, 0.0


def of_matrix(rotation: Sequence[Sequence[float]]) -> Wxyz:
    """Of a 3 x 3 rotation matrix, by its largest component (Shepperd)."""
    (a, b, c), (d, e, f), (g, h, i) = ([float(value) for value in row] for row in rotation)
    products = (
        (1 + a + e + i, h - f, c - g, d - b),
        (h - f, 1 + a - e - i, d + b, c + g),
        (c - g, d + b, 1 - a + e - i, h + f),
        (d - b, c + g, h + f, 1 - a - e + i),
    )
    largest = max(range(4), key=lambda k: products[k][k])
    row = products[largest]
    norm = math.hypot(*row)
    w, x, y, z = (value / norm for value in row)
    return w, x, y, z


def to_matrix(q: Wxyz) -> npt.NDArray[np.float64]:
    """The 3 x 3 rotation matrix of a unit quaternion."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
