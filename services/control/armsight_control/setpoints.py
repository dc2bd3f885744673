"""The setpoint in force: what sim last accepted, and what was commanded since.

A setpoint is memory, not a measurement: it settles the twin and is where every motion begins. How long commands take
to be in force is told by the capture time from which sim says that they are.
"""

from collections import deque
from dataclasses import dataclass
from statistics import median

import numpy as np
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from armsight.times import NS_PER_S
from armsight_control.chain import Array, Chain
from armsight_control.errors import SetpointError

# Sim clamps what is this little beyond a limit.
_SAME_RAD = 1e-5
_OUTSIDE_RAD = 1e-3
# A command that is this old and was never accepted was refused.
_UNCONFIRMED_NS = 300_000_000
# After this long without a command, what sim says counts alone: its watchdog has stopped the arm.
_RECENT_NS = 150_000_000
# Until a command was seen in force: one frame of sim's 30 a second.
_FIRST_LEAD_S = 1 / 30
_LEADS = 15
_LONGEST_LEAD_S = 0.3


@dataclass(frozen=True, slots=True)
class Commanded:
    """A setpoint that was sent."""

    capture_ns: int
    """Of the positions that it answered."""
    q: Array


def setpoint_of(message: JointStates, chain: Chain) -> Array:
    """The joints of an accepted setpoint, in the arm's order.

    Raises:
        SetpointError: a joint is missing, not finite or outside of its limits.
    """
    given = {state.name: state.position for state in message.joints if state.HasField("position")}
    return configuration(given, chain, _OUTSIDE_RAD)


def configuration(given: dict[str, float], chain: Chain, outside_rad: float = 1e-6) -> Array:
    """Joint angles by name as an array, clamped to the limits where they are at most ``outside_rad`` beyond.

    Raises:
        SetpointError: not every joint of the arm once, not finite, or outside of the limits.
    """
    if set(given) != set(chain.names):
        raise SetpointError(f"joints {', '.join(sorted(given)) or 'none'}; this arm needs {', '.join(chain.names)}")
    q = np.array([given[name] for name in chain.names])
    for name, angle, (lower, upper) in zip(chain.names, q, chain.limits, strict=True):
        if not lower - outside_rad <= angle <= upper + outside_rad:
            raise SetpointError(f"{name} at {angle:g} rad is outside of its limits {lower:.4f} to {upper:.4f} rad")
    return chain.clip(q)


class Setpoints:
    """Follows what was commanded and what was accepted."""

    def __init__(self) -> None:
        """Nothing is accepted yet."""
        self.forget()

    def forget(self) -> None:
        """Of another arm, or another run of sim: waits for a new accepted setpoint."""
        self._accepted: Array | None = None
        self._last: Commanded | None = None
        self._unconfirmed: deque[Commanded] = deque(maxlen=64)
        self._leads_s: deque[float] = deque(maxlen=_LEADS)

    @property
    def lead_s(self) -> float:
        """From the capture time that a command answers to that of the first frame in which it is in force, lately."""
        return median(self._leads_s) if self._leads_s else _FIRST_LEAD_S

    def accept(self, q: Array, capture_ns: int | None = None) -> bool:
        """Takes what sim says is in force; true where it is none of the commands sent (a reset, a limit, a stop).

        Args:
            q: the setpoint.
            capture_ns: of the first frame in which it is in force, if that is known.
        """
        same = self._accepted is not None and np.abs(q - self._accepted).max() < _SAME_RAD
        self._accepted = q
        for i, sent in enumerate(self._unconfirmed):
            if np.abs(sent.q - q).max() < _SAME_RAD:
                lead_s = 0.0 if capture_ns is None else (capture_ns - sent.capture_ns) / NS_PER_S
                if 0 < lead_s <= _LONGEST_LEAD_S:
                    self._leads_s.append(lead_s)
                for _ in range(i + 1):
                    self._unconfirmed.popleft()
                return False
        if same:
            return False
        self._last = None
        self._unconfirmed.clear()
        return True

    def command(self, capture_ns: int, q: Array) -> None:
        """Remembers a command that is sent now."""
        self._last = Commanded(capture_ns, q)
        self._unconfirmed.append(self._last)

    def in_force(self, capture_ns: int) -> Array | None:
        """Where a command that answers ``capture_ns`` begins; nothing without an accepted setpoint."""
        if self._accepted is None:
            return None
        if self._unconfirmed and capture_ns - self._unconfirmed[0].capture_ns > _UNCONFIRMED_NS:
            self._last = None
            self._unconfirmed.clear()
        if self._last is None or capture_ns - self._last.capture_ns > _RECENT_NS:
            return self._accepted
        return self._last.q
