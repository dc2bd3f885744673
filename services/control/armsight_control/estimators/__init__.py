"""From what vision saw to joint angles: the report's two Parts, and all joints at once from all markers.

- ``part1``, ``part2``: the report's formulas (:mod:`.parts` knows which of them applies);
- ``all``: :mod:`.all_joints`, by way of :mod:`.marker_model`, :mod:`.gauss_newton`, :mod:`.kalman`, :mod:`.candidates`;

- ``module:name`` or ``file.py:name``: one of a person's own (:mod:`.own`).

Each is a pure step; :mod:`.observer` carries the state for the loop.
"""

from armsight_control.estimators.all_joints import AllJoints, Outcome, Track
from armsight_control.estimators.estimate import Estimate
from armsight_control.estimators.observer import NAMES, Observer, check_estimator, observer_of
from armsight_control.estimators.parts import ESTIMATORS, Estimator, choose

__all__ = [
    "ESTIMATORS",
    "NAMES",
    "AllJoints",
    "Estimate",
    "Estimator",
    "Observer",
    "Outcome",
    "Track",
    "check_estimator",
    "choose",
    "observer_of",
]
