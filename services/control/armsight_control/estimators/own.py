"""An estimator of a person's own, ``--estimator module:Class``, held to what ours are held to.

It is made once for an arm, and asked for each instant, later ones after earlier ones::

    class Mine:
        def __init__(self, arm: Arm) -> None: ...
        def step(self, positions: Positions, setpoint: Array) -> Array: ...

``positions`` are what the cameras saw, base frame, metres, without the markers that are lost; ``setpoint`` (n,) is in
force, radians. It gives back the angles of all joints, (n,). Whatever it says, the arm moves only where the tip that
follows from it is near where the setpoint has it (:mod:`armsight_control.safety`).
"""

import numpy as np

from armsight_control import own
from armsight_control.bodies import Seen
from armsight_control.chain import Array
from armsight_control.description import Arm
from armsight_control.errors import ControlError, PositionsError
from armsight_control.estimators.estimate import Estimate
from armsight_control.kinematics import forward
from armsight_control.positions import Positions

_REASON = "estimator"


class Own:
    """Such an estimator at work on one arm: an :class:`~armsight_control.estimators.observer.Observer`."""

    def __init__(self, place: str, arm: Arm) -> None:
        """Makes it.

        Raises:
            OwnPartError: there is nothing to call at this place.
            ControlError: it can't be made for this arm.
        """
        self._place, self._chain = place, arm.chain
        try:
            self._step = own.load(place)(arm).step
        except ControlError:
            raise
        except Exception as error:  # somebody else's code: anything can go wrong in it
            raise ControlError(f"the estimator {place} can't be made: {type(error).__name__}: {error}") from error

    def needs_no_angles(self, tip: Seen) -> bool:
        """No: the arm moves on what it says, and not on anything else."""
        del tip
        return False

    def look(self, positions: Positions, setpoint: Array, preferred: str) -> tuple[Estimate, Array]:
        """The angles at one instant, and the tip in the base frame, metres.

        Raises:
            PositionsError: the estimator failed, or what it gave back is no configuration of this arm.
        """
        del preferred  # the Parts'
        try:
            angles = np.asarray(self._step(positions, setpoint.copy()), dtype=np.float64)
        except Exception as error:  # as above
            text = f"the estimator {self._place} failed: {type(error).__name__}: {error}"
            raise PositionsError(_REASON, text) from error
        if angles.shape != setpoint.shape or not np.isfinite(angles).all():
            text = f"the estimator {self._place} gave back {angles}: expected {len(setpoint)} finite angles"
            raise PositionsError(_REASON, text)
        estimate = Estimate(self._place, angles, lambda: (True,) * len(angles), misfit=0.0)
        return estimate, forward(self._chain, angles)
