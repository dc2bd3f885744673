"""From the directions of links 3 and 4 to joint angles: the report's two Parts, and which of them to ask.

A Part is a pure step: previous angles and two directions in, angles and an estimate out. The previous angles
carry what the positions can't tell: signs, turns of joint 1, and the values held in gimbal lock.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from armsight_control.chain import Array
from armsight_control.estimators import part1, part2
from armsight_control.estimators.estimate import Estimate

# How near 0 the setpoint of the joint that an estimator takes as fixed must be: half of the exercise's line of 0.15 rad
# would already be seen in the other angles.
FIXED_TOLERANCE_RAD = 0.02


@dataclass(frozen=True, slots=True)
class Estimator:
    """One of the report's Parts."""

    name: str
    fixed_joint: int
    """Index of the joint that it takes to be at 0."""
    step: Callable[[Array, Array, Array], tuple[Array, Estimate]]
    """(previous angles, r3, r4) → (angles for the next step, estimate)."""


ESTIMATORS: Mapping[str, Estimator] = MappingProxyType(
    {
        part1.NAME: Estimator(part1.NAME, part1.FIXED_JOINT, part1.step),
        part2.NAME: Estimator(part2.NAME, part2.FIXED_JOINT, part2.step),
    }
)


def choose(setpoint: Array, preferred: str) -> Estimator:
    """The preferred estimator if its fixed joint's setpoint is at 0, else another whose is, else the preferred one.

    With neither joint at 0 no Part applies: the preferred one then reports every joint as not observable, because its
    angles don't explain the positions (:attr:`Estimate.misfit`).
    """
    ordered = sorted(ESTIMATORS.values(), key=lambda estimator: estimator.name != preferred)
    for estimator in ordered:
        if np.abs(setpoint[estimator.fixed_joint]) <= FIXED_TOLERANCE_RAD:
            return estimator
    return ordered[0]
