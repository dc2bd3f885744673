"""What has come and is not written yet: bounded, and what does not fit is counted."""

import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

from armsight.bus import Sample
from armsight.topics import CAMERA_IMAGE

# So that pixels never take the place of what is said about them.
_RESERVE_BYTES = 16 << 20


@dataclass(frozen=True, slots=True)
class Arrival:
    """One message, and when it came."""

    sample: Sample
    at_ns: int
    """This machine's wall clock; never less than the one's before it."""
    sequence: int
    """Of its key, from 1; what was lost has a number, too."""


class Backlog:
    """A queue from the threads that read the bus to the one that writes."""

    def __init__(self, limit_bytes: int, wall_ns: Callable[[], int] = time.time_ns) -> None:
        """Frames may fill ``limit_bytes``, all else a little more."""
        self._limit_bytes = limit_bytes
        self._wall_ns = wall_ns
        self._changed = threading.Condition()
        self._waiting: deque[Arrival] = deque()
        self._bytes = 0
        self._last_ns = 0
        self._sequences: Counter[str] = Counter()
        self._lost: Counter[str] = Counter()

    @property
    def lost(self) -> dict[str, int]:
        """Messages that found no room, by key."""
        with self._changed:
            return dict(self._lost)

    @property
    def bytes(self) -> int:
        """That wait."""
        return self._bytes

    def put(self, sample: Sample, patience_s: float = 0.0) -> bool:
        """Adds a message, waiting for room as long as the patience lasts; returns whether there was some."""
        limit = self._limit_bytes + (0 if sample.topic is CAMERA_IMAGE else _RESERVE_BYTES)
        size = len(sample.payload)
        with self._changed:
            self._sequences[sample.key] += 1
            # an empty queue takes anything, or a frame that is larger than it would never be recorded
            has_room = self._changed.wait_for(lambda: not self._bytes or self._bytes + size <= limit, patience_s)
            if not has_room:
                self._lost[sample.key] += 1
                return False
            self._last_ns = max(self._last_ns, self._wall_ns())
            self._waiting.append(Arrival(sample, self._last_ns, self._sequences[sample.key]))
            self._bytes += size
            self._changed.notify_all()
        return True

    def take(self, timeout_s: float) -> Arrival | None:
        """The oldest message; waits for one."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._waiting, timeout_s):
                return None
            arrival = self._waiting.popleft()
            self._bytes -= len(arrival.sample.payload)
            self._changed.notify_all()
            return arrival

    def give_up(self) -> None:
        """Counts as lost what still waits."""
        with self._changed:
            self._lost.update(arrival.sample.key for arrival in self._waiting)
            self._waiting.clear()
            self._bytes = 0
