"""Which commands move the arm: fresh, in order, complete, finite, within the limits; all others are refused by name.

Times are capture times, integer nanoseconds: the gate runs on simulated time, never on anybody's wall clock.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from armsight.times import NS_PER_S, from_duration, from_timestamp
from armsight.v1.joints_pb2 import JointCommand
from armsight_sim.errors import PoseError
from armsight_sim.world import World

Vector = npt.NDArray[np.float64]

LONGEST_VALIDITY_S = 1.0
"""No command may claim to be fresh for longer."""


class Verdict(Enum):
    """What to do with a command."""

    MOVE = "move"
    HOLD = "hold"
    REFUSE = "refuse"


@dataclass(frozen=True, slots=True)
class Decision:
    """The gate's answer to one command."""

    verdict: Verdict
    goal: Vector | None = None
    """Where to go, for MOVE."""
    reason: str = ""
    """One word for the counters, for REFUSE."""
    detail: str = ""
    """What was wrong, for a person."""


class CommandGate:
    """Decides on commands in the order in which they arrive; remembers the last instant that was answered."""

    def __init__(self, world: World, *, external_cameras: bool = False) -> None:
        """Takes names and limits from the world.

        Args:
            world: of the arm.
            external_cameras: whether frames are not the simulation's own: then they may be of any instant up to now.
        """
        self._world, self._external_cameras = world, external_cameras
        self._last_answered_ns: int | None = None
        self._not_before_ns = 0

    def refuse_before(self, capture_ns: int) -> None:
        """From now on refuses answers to instants before this one: what they saw is no longer so (a reset)."""
        self._not_before_ns = capture_ns

    def decide(self, command: JointCommand, now_ns: int, latest_capture_ns: int, *, stopped: bool) -> Decision:
        """Decides on one command.

        Args:
            command: as it came from the bus.
            now_ns: simulated time now.
            latest_capture_ns: instant of the simulation's last frames: nothing can answer a later one, where there are
                no others.
            stopped: whether a stop is in force.
        """
        answers_ns = from_timestamp(command.answers)
        refusal = self._refusal(command, answers_ns, now_ns, now_ns if self._external_cameras else latest_capture_ns)
        if refusal is not None:
            return refusal
        self._last_answered_ns = answers_ns
        if command.hold:
            return Decision(Verdict.HOLD)
        if stopped:
            return _refuse("stopped", "the arm is stopped: release it first")
        return self._goal(command)

    def _refusal(self, command: JointCommand, answers_ns: int, now_ns: int, latest_ns: int) -> Decision | None:
        if answers_ns > latest_ns:
            return _refuse("future", f"answers {answers_ns}, an instant that has not been seen yet")
        if answers_ns < self._not_before_ns:
            return _refuse("before_reset", "answers an instant before the last reset")
        valid_s = from_duration(command.valid_for)
        if not 0.0 < valid_s <= LONGEST_VALIDITY_S:
            return _refuse("validity", f"valid_for of {valid_s:g} s is not within 0 to {LONGEST_VALIDITY_S:g} s")
        age_s = (now_ns - answers_ns) / NS_PER_S
        if age_s > valid_s:
            return _refuse("stale", f"answers an instant {age_s:.3f} s ago, valid for {valid_s:.3f} s")
        if self._last_answered_ns is not None:
            if answers_ns == self._last_answered_ns:
                return _refuse("duplicate", f"instant {answers_ns} was answered before")
            if answers_ns < self._last_answered_ns:
                return _refuse("out_of_order", f"a later instant than {answers_ns} was answered before")
        return None

    def _goal(self, command: JointCommand) -> Decision:
        names = [joint.name for joint in command.joints]
        expected = self._world.joint_names
        if sorted(names) != sorted(expected):
            return _refuse("joints", f"names {', '.join(names) or 'no joint'} instead of {', '.join(expected)}")
        positions = {joint.name: joint.position_rad for joint in command.joints}
        if not np.isfinite(list(positions.values())).all():
            return _refuse("not_finite", "a position is not a finite number")
        try:
            return Decision(Verdict.MOVE, goal=self._world.pose(positions))
        except PoseError as error:
            return _refuse("limits", str(error))


def _refuse(reason: str, detail: str) -> Decision:
    return Decision(Verdict.REFUSE, reason=reason, detail=detail)
