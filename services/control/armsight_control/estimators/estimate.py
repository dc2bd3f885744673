"""What an estimator says of one instant."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armsight_control.chain import Array
from armsight_control.kinematics import directions

# Beyond this the angles do not explain the positions: the joint taken as fixed is not where it was taken to be.
_MISFIT_MAX = 0.15


@dataclass(frozen=True)
class Estimate:
    """Angles of all joints, in radians."""

    estimator: str
    angles: Array
    told: Callable[[], tuple[bool, ...]]
    """Finds out :attr:`observable`: the arm waits for the angles, not for this."""
    misfit: float
    """How far the directions that follow from the angles are from the measured ones, as a length of unit vectors."""
    sigma: Array | None = None
    """One standard deviation of every joint, where the estimator knows it."""
    velocity: Array | None = None
    """Of every joint, rad/s, where the estimator knows it."""

    @cached_property
    def observable(self) -> tuple[bool, ...]:
        """False where the angle is not measured: held in gimbal lock, or taken as fixed."""
        return self.told()


def judge(estimator: str, angles: Array, observable: tuple[bool, ...], r3: Array, r4: Array) -> Estimate:
    """An estimate, with every joint marked as not observable where the angles do not explain the positions."""
    r3_again, r4_again = directions(angles)
    misfit = max(float(np.linalg.norm(r3_again - r3)), float(np.linalg.norm(r4_again - r4)))
    if misfit > _MISFIT_MAX:
        observable = (False,) * len(observable)
    return Estimate(estimator, angles, lambda: observable, misfit)


def angle_between(first: Array, second: Array) -> float:
    """Between two unit vectors, 0 to pi."""
    return math.acos(clip1(float(first @ second)))


def clip1(value: float) -> float:
    """Into [-1, 1]: noise takes products of unit vectors a little beyond."""
    return min(1.0, max(-1.0, value))
