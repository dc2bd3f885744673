"""Frames from the bus. The loop notices nothing of it: small keys alone, no images."""

import queue
from threading import Lock
from typing import Any

from armsight.bus import Bus, Received
from armsight.times import wall_ns
from armsight_operator.trace.stages import KEYS, Frame, Joiner

_KEEP = 64
"""Messages that wait: lockstep makes hundreds a second."""


class Listener:
    """Joins what goes over the bus into frames; take them with :meth:`get`."""

    def __init__(self, bus: Bus) -> None:
        """Subscribes."""
        self._lock = Lock()
        self._joiner = Joiner()
        self._ready: queue.Queue[Frame] = queue.Queue(maxsize=1000)
        self.lost = 0
        """Frames that nobody took in time."""
        for topic in KEYS:
            bus.subscriber(topic, keep=_KEEP, on_message=self._take)

    def get(self, timeout_s: float) -> Frame | None:
        """The next frame whose answer is known; nothing within the time."""
        try:
            return self._ready.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def _take(self, received: Received[Any]) -> None:
        heard_ns = wall_ns()
        with self._lock:
            frame = self._joiner.take(received.message, heard_ns)
        if frame is None:
            return
        try:
            self._ready.put_nowait(frame)
        except queue.Full:
            self.lost += 1
