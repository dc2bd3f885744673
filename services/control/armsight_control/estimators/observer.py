"""What the loop asks for the angles: the named estimator and what it carries from one instant to the next."""

import numpy as np

from armsight.counters import Counters
from armsight_control.chain import Array
from armsight_control.description import Arm
from armsight_control.errors import ControlError, PositionsError
from armsight_control.estimators import all_joints, part1, part2
from armsight_control.estimators.all_joints import AllJoints, Track
from armsight_control.estimators.estimate import Estimate
from armsight_control.estimators.parts import ESTIMATORS, choose
from armsight_control.kinematics import forward, need_report
from armsight_control.positions import (
    TIP_SIGMA_MAX_M,
    LastLinks,
    Positions,
    directions_of,
    last_links_of,
    tip_line_of,
)

PARTS = "parts"
NAMES = (all_joints.NAME, part1.NAME, part2.NAME, PARTS)
"""`parts` stands for whichever Part's fixed joint is at 0."""

# An estimate of a Part this far from the setpoint in force is on a wrong branch, not late.
_WRONG_BRANCH_RAD = 1.0


def check_estimator(name: str) -> str:
    """The name, if there is such an estimator.

    Raises:
        ControlError: there is none.
    """
    if name not in NAMES:
        raise ControlError(f"no estimator {name!r}; there are {', '.join(NAMES)}")
    return name


class Observer:
    """One estimator at work on one arm."""

    def __init__(self, name: str, arm: Arm, counters: Counters) -> None:
        """Has seen nothing yet.

        Raises:
            UnsupportedArmError: the estimator is for the report's arm, and this is another.
        """
        self._name = check_estimator(name)
        self._arm = arm
        self._links: LastLinks | None = None
        if name != all_joints.NAME:
            need_report(arm.chain, f"the estimator {name}", all_joints.NAME)
            self._links = last_links_of(arm)
        line = tip_line_of(arm)
        on_last = [marker for marker, point in arm.markers.items() if point.joint == arm.chain.tip.joint]
        self._on_last = on_last if line is None else list(line.along)
        self._vague_m = TIP_SIGMA_MAX_M * arm.chain.scale
        self._counters = counters
        self._all = AllJoints(arm)
        self._track: Track | None = None
        self._previous: tuple[str, Array] | None = None

    def look(self, positions: Positions, setpoint: Array, preferred: str) -> tuple[Estimate, Array]:
        """The angles at one instant, and the tip in the base frame, metres.

        Args:
            positions: of a later instant than the last ones.
            setpoint: in force.
            preferred: the Part that `parts` takes where both apply.

        Raises:
            PositionsError: the tip is known too vaguely, or a Part's markers are lost.
        """
        if self._links is None:
            return self._look_at_all(positions, setpoint)
        directions = directions_of(positions, self._links)
        estimator = choose(setpoint, preferred) if self._name == PARTS else ESTIMATORS[self._name]
        if self._previous is None or self._previous[0] != estimator.name:
            self._previous = (estimator.name, setpoint)
        angles, estimate = estimator.step(self._previous[1], directions.r3, directions.r4)
        off = np.abs(estimate.angles - setpoint) > _WRONG_BRANCH_RAD
        if (off & np.array(estimate.observable)).any():
            self._counters.add("estimator_restarted")
            angles, estimate = estimator.step(setpoint, directions.r3, directions.r4)
        self._previous = (estimator.name, angles if any(estimate.observable) else setpoint)
        return estimate, directions.tip

    def _look_at_all(self, positions: Positions, setpoint: Array) -> tuple[Estimate, Array]:
        outcome = self._all.step(self._track, positions, setpoint)
        self._track = outcome.track
        if outcome.restarted:
            self._counters.add("estimator_restarted")
        if outcome.tip_sigma > self._vague_m:
            lost = [name for name in self._on_last if name not in positions.seen]
            unseen = f"{' and '.join(lost)} can't be seen by any camera: " if lost else ""
            text = f"{unseen}the tip is known to ±{outcome.tip_sigma:.2f} m only; another camera must see the arm"
            raise PositionsError("lost" if lost else "vague", text)
        return outcome.estimate, forward(self._arm.chain, outcome.estimate.angles)
