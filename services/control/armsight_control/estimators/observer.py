"""What the loop asks for the angles: the named estimator and what it carries from one instant to the next."""

from typing import Protocol

import numpy as np

from armsight.counters import Counters
from armsight_control import own as own_parts
from armsight_control.bodies import Seen
from armsight_control.chain import Array
from armsight_control.description import Arm
from armsight_control.errors import ControlError, PositionsError
from armsight_control.estimators import all_joints, part1, part2
from armsight_control.estimators.all_joints import AllJoints, Track
from armsight_control.estimators.estimate import Estimate
from armsight_control.estimators.own import Own
from armsight_control.estimators.parts import ESTIMATORS, choose
from armsight_control.kinematics import forward, need_report
from armsight_control.positions import (
    TIP_SIGMA_MAX_M,
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

# Of the uncertainty that stops the arm: a tip seen with less needs no angles to say where it is.
_SEEN_WELL = 0.1


def check_estimator(name: str) -> str:
    """The name, if there is such an estimator; one of a person's own (:mod:`.own`) is imported for it.

    Raises:
        ControlError: there is none.
    """
    if own_parts.is_place(name):
        own_parts.load(name)
    elif name not in NAMES:
        raise ControlError(f"no estimator {name!r}; there are {', '.join(NAMES)}")
    return name


class Observer(Protocol):
    """One estimator at work on one arm."""

    def needs_no_angles(self, tip: Seen) -> bool:
        """Whether the arm may move on where its tip is seen, and the angles be told later.

        Args:
            tip: as the markers on one line with it show it.
        """

    def look(self, positions: Positions, setpoint: Array, preferred: str) -> tuple[Estimate, Array]:
        """The angles at one instant, and the tip in the base frame, metres.

        Args:
            positions: of a later instant than the last ones.
            setpoint: in force.
            preferred: the Part that `parts` takes where both apply.

        Raises:
            PositionsError: the angles or the tip can't be told from these positions.
        """


def observer_of(name: str, arm: Arm, counters: Counters) -> Observer:
    """The estimator of this name for an arm; has seen nothing yet.

    Raises:
        UnsupportedArmError: the estimator is for the report's arm, and this is another.
        ControlError: no estimator of that name, or one of a person's own that can't be made.
    """
    if own_parts.is_place(name):
        return Own(name, arm)
    check_estimator(name)
    return AllAtOnce(arm, counters) if name == all_joints.NAME else Parts(name, arm, counters)


class AllAtOnce:
    """All joints from all markers."""

    def __init__(self, arm: Arm, counters: Counters) -> None:
        """Has seen nothing yet."""
        self._chain, self._counters = arm.chain, counters
        line = tip_line_of(arm)
        on_last = [marker for marker, point in arm.markers.items() if point.joint == arm.chain.tip.joint]
        self._on_last = on_last if line is None else list(line.along)
        self._vague_m = TIP_SIGMA_MAX_M * arm.chain.scale
        self._all = AllJoints(arm)
        self._track: Track | None = None

    def needs_no_angles(self, tip: Seen) -> bool:
        """Where it is seen far better than it must be known."""
        return tip.sigma_m <= _SEEN_WELL * self._vague_m

    def look(self, positions: Positions, setpoint: Array, preferred: str) -> tuple[Estimate, Array]:
        """As :meth:`Observer.look`; refuses where the tip is known too vaguely."""
        del preferred  # the Parts'
        outcome = self._all.step(self._track, positions, setpoint)
        self._track = outcome.track
        if outcome.restarted:
            self._counters.add("estimator_restarted")
        if outcome.tip_sigma > self._vague_m:
            lost = [name for name in self._on_last if name not in positions.seen]
            unseen = f"{' and '.join(lost)} can't be seen by any camera: " if lost else ""
            text = f"{unseen}the tip is known to ±{outcome.tip_sigma:.2f} m only; another camera must see the arm"
            raise PositionsError("lost" if lost else "vague", text)
        return outcome.estimate, forward(self._chain, outcome.estimate.angles)


class Parts:
    """The report's two Parts, or whichever of them applies."""

    def __init__(self, name: str, arm: Arm, counters: Counters) -> None:
        """Has seen nothing yet.

        Raises:
            UnsupportedArmError: this is not the report's arm.
        """
        need_report(arm.chain, f"the estimator {name}", all_joints.NAME)
        self._name, self._counters = name, counters
        self._links = last_links_of(arm)
        self._previous: tuple[str, Array] | None = None

    def needs_no_angles(self, tip: Seen) -> bool:
        """No: a Part says itself whether it applies."""
        del tip
        return False

    def look(self, positions: Positions, setpoint: Array, preferred: str) -> tuple[Estimate, Array]:
        """As :meth:`Observer.look`; refuses where a Part's markers are lost."""
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
