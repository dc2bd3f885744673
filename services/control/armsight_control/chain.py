"""A serial chain of revolute joints, as arrays."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Triple = tuple[float, float, float]
"""A point or vector in plain floats: numpy's calls on arrays of three cost ten times what they compute."""
Rows = Sequence[Sequence[float]]
"""A small matrix, row by row, in plain floats."""

_FIRST_ARM_M = 10.0


def farthest(q: Array, other: Array) -> float:
    """The longest way of any joint between two configurations, radians."""
    ways: list[float] = (q - other).tolist()
    return max(map(abs, ways))


@dataclass(frozen=True, slots=True)
class Point:
    """A point that moves with a joint's child body."""

    joint: int
    """Index of the joint; -1 is the base frame."""
    position: Array
    """In that joint's frame, metres."""


@dataclass(frozen=True, eq=False)
class Chain:
    """Joints in order from the base; lengths in metres, angles in radians. Equal where all values are: it can be a key.

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

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Chain) and self._values == other._values

    def __hash__(self) -> int:
        return hash(self._values)

    @cached_property
    def _values(self) -> tuple[object, ...]:
        arrays = (self.origins, self.axes, self.limits, self.max_speed, self.tip.position)
        return self.names, self.tip.joint, *(array.tobytes() for array in arrays)

    @property
    def count(self) -> int:
        """Number of joints."""
        return len(self.names)

    @cached_property
    def joints(self) -> tuple[tuple[Triple, Triple], ...]:
        """Origin and axis of every joint, in plain floats."""
        return tuple(
            ((x, y, z), (k, l, m))
            for (x, y, z), (k, l, m) in zip(self.origins.tolist(), self.axes.tolist(), strict=True)  # noqa: E741
        )

    @cached_property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Lower and upper limit of every joint, in plain floats."""
        return tuple((lower, upper) for lower, upper in self.limits.tolist())

    @cached_property
    def scale(self) -> float:
        """Its length from joint 1 to the tip, stretched, as a share of the first arm's 10 m: what distances go by."""
        lengths = np.linalg.norm(self.origins[1:], axis=1).sum() + np.linalg.norm(self.tip.position)
        return float(lengths) / _FIRST_ARM_M

    def clip(self, q: Array) -> Array:
        """The nearest configuration within the limits."""
        # what np.clip does, without its checks: half the time for one configuration
        return np.minimum(np.maximum(q, self.limits[:, 0]), self.limits[:, 1])
