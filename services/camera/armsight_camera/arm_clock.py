"""This process' monotonic time as capture time: on the arm's clock, on Unix time where there is none.

What `clock` says has always been said a little earlier than it arrives: of the differences between what it said and
when that came, the largest is the nearest to the truth. Nothing in here reads a clock; times are integer nanoseconds.
"""

from collections import deque

from armsight.times import NS_PER_S

WINDOW_NS = NS_PER_S // 2
"""Of what was heard lately."""

_FELL_BEHIND = 2
"""Messages one after the other, each later by more than a period: so long the bus holds nothing back, but a simulation
that could not keep up has fallen behind. It would refuse frames that are ahead of it."""

ANOTHER_CLOCK_NS = NS_PER_S
"""No delay is that long: one who says an earlier time than this has begun anew."""


class ArmClock:
    """Maps monotonic time to capture time."""

    def __init__(self, unix_offset_ns: int) -> None:
        """On Unix time until a clock is heard.

        Args:
            unix_offset_ns: Unix time less monotonic time.
        """
        self._offset_ns = unix_offset_ns
        self._heard: deque[tuple[int, int]] = deque()
        self.changes = 0
        """How often another clock came into force: capture times may have gone back with it."""

    def heard(self, clock_ns: int, received_ns: int, period_ns: int) -> None:
        """Takes what `clock` said.

        Args:
            clock_ns: the capture time that it said.
            received_ns: when it came, on the monotonic clock.
            period_ns: from one message to the next; 0 where it is not known.
        """
        offset_ns = clock_ns - received_ns
        is_another = not self._heard or abs(offset_ns - self._offset_ns) > ANOTHER_CLOCK_NS
        if is_another:
            self._heard.clear()
        self._heard.append((received_ns, offset_ns))
        last = list(self._heard)[-_FELL_BEHIND:]
        held_up_ns = self._offset_ns - max(offset for _, offset in last)
        if len(last) == _FELL_BEHIND and held_up_ns > period_ns > 0:
            self._heard = deque(last)
        while received_ns - self._heard[0][0] > WINDOW_NS:
            self._heard.popleft()
        self._offset_ns = max(offset for _, offset in self._heard)
        # at last: another thread that sees it asks for times of the new clock
        self.changes += is_another

    def capture_ns(self, monotonic_ns: int) -> int:
        """The capture time of an instant of the monotonic clock."""
        return monotonic_ns + self._offset_ns
