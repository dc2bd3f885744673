"""The setpoints that were sent, and for which instant each of them was."""

from collections import deque

from armsight.times import NS_PER_S
from armsight_control.chain import Array
from armsight_control.trajectory import State, at_rest

# More than the frames that a command takes to be in force.
_LENGTH = 8
# Beyond this a step is no parabola any more.
_LONGEST_STEP_S = 0.1
# Capture times are rounded to nanoseconds, leads are a median.
_SAME_INSTANT_S = 1e-3


class History:
    """Of one motion, from its rest on."""

    def __init__(self) -> None:
        """Nothing was sent yet."""
        self._sent: deque[tuple[int, State]] = deque(maxlen=_LENGTH)

    def forget(self) -> None:
        """The motion ended."""
        self._sent.clear()

    def remember(self, effect_ns: int, state: State) -> None:
        """Takes a setpoint and the capture time at which the arm is to be there."""
        self._sent.append((effect_ns, state))

    def at(self, capture_ns: int, resting: Array) -> Array:
        """Where the setpoint was at an instant, radians; ``resting`` where nothing was sent."""
        for effect_ns, state in self._sent:
            early_s = (effect_ns - capture_ns) / NS_PER_S
            if early_s >= -_SAME_INSTANT_S:
                return state.before(min(early_s, _LONGEST_STEP_S))
        return (self._sent[-1][1] if self._sent else at_rest(resting)).position
