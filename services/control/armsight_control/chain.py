"""A serial chain of revolute joints, as arrays."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Point:
    """A point that moves with a joint's child body."""

    joint: int
    """Index of the joint; -1 is the base frame."""
    position: Array
    """In that joint's frame, metres."""


@dataclass(frozen=True, slots=True)
class Chain:
    """Joints in order from the base; lengths in metres, angles in radians.

    Frames: ``base`` is the first joint's frame at angle 0; the frame of joint i turns with its child body.
    """

    names: tuple[str, ...]
    origins: Array
    """n x 3, of each joint in its parent's frame at angle 0."""
    axes: Array
    """n x 3, unit vectors in the joint's own frame."""
    limits: Array
    """n x 2: lower, upper."""
    max_speed: Array
    """n, rad/s."""
    tip: Point

    @property
    def count(self) -> int:
        """Number of joints."""
        return len(self.names)

    def clip(self, q: Array) -> Array:
        """The nearest configuration within the limits."""
        return np.clip(q, self.limits[:, 0], self.limits[:, 1])
