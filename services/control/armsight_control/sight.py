"""What the cameras see beside the joints: the tip against what was commanded, the sphere and the box."""

import math

import numpy as np

from armsight.counters import Counters
from armsight.times import NS_PER_S
from armsight.v1.joints_pb2 import JointPositions
from armsight_control import safety
from armsight_control.bodies import BodyNames, Seen, seen
from armsight_control.chain import Array
from armsight_control.correction import corrected
from armsight_control.description import Arm
from armsight_control.tracking import Moving, Track, observed, predicted
from armsight_control.trajectory import Step

# Bodies go on as they went for this long unseen (the arm hides the box for a third of its period, in parts).
FORESEEN_S = 1.0
# What is taken for a body and lies elsewhere is another thing (half-hidden, the box passes for the sphere for some
# frames), but for this long without one where it should be.
_MISTAKEN_S = 0.4


class Sight:
    """Follows one arm's tip and the bodies beside it from instant to instant."""

    def __init__(self, arm: Arm, names: BodyNames, counters: Counters) -> None:
        """Has seen nothing yet."""
        self._arm, self._names, self._counters = arm, names, counters
        self._sphere: Track | None = None
        self._box: Track | None = None
        self._expected: safety.Expected | None = None
        self._commanded = np.zeros(3)
        self.correction = np.zeros(3)
        """The slow part of the tip as seen less the tip as commanded, base frame, metres."""

    def look(
        self, message: JointPositions, tip: Seen | None, commanded: Array, step: Step, learn_s: float | None
    ) -> None:
        """Takes what vision saw.

        Args:
            message: from vision, with the bodies.
            tip: as the markers on one line with it show it; without them nothing says where it is but the model.
            commanded: where the setpoint of this instant puts the tip, base frame, metres.
            step: this instant.
            learn_s: in which time a difference is taken for one of the model; none where the arm does not follow the
                setpoint closely, so that it says nothing of that.

        Raises:
            PositionsError: the tip jumped as nobody told it to.
        """
        self._sphere = self._watched(self._sphere, message, self._names.sphere, step)
        self._box = self._watched(self._box, message, self._names.box, step)
        scale = self._arm.chain.scale
        if tip is None:
            return
        speed = 0.0 if self._expected is None else math.dist(commanded, self._commanded) / step.dt_s
        self._commanded = commanded
        self._expected = safety.expect(self._expected, tip, commanded, scale)
        safety.check_expected(self._expected)
        if learn_s is not None:
            self.correction = corrected(self.correction, tip, commanded, speed, step.dt_s, learn_s, scale)

    def sphere(self, step: Step, effect_ns: int) -> Moving | None:
        """The sphere's centre in motion at an instant; nothing where it was not seen for too long."""
        return self._foreseen(self._sphere, step, effect_ns)

    def box(self, step: Step, effect_ns: int) -> Moving | None:
        """The box's centre, as :meth:`sphere`."""
        return self._foreseen(self._box, step, effect_ns)

    def _watched(self, track: Track | None, message: JointPositions, name: str | None, step: Step) -> Track | None:
        found = None if name is None else seen(message, name, self._arm)
        if found is None:
            return track
        after = observed(track, step.capture_ns, found.position, found.sigma_m / math.sqrt(3))
        if track is None or not after.jumped or step.capture_ns - track.stamp_ns > _MISTAKEN_S * NS_PER_S:
            return after
        self._counters.add("body_jump")
        return track

    def _foreseen(self, track: Track | None, step: Step, effect_ns: int) -> Moving | None:
        if track is None or step.capture_ns - track.stamp_ns > FORESEEN_S * NS_PER_S:
            return None
        return predicted(track, effect_ns, step.capture_ns, FORESEEN_S)
