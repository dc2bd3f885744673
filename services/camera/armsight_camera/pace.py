"""When the pictures of files are due: those of one number at one time, whichever file they are of."""

import threading

from armsight.times import NS_PER_S

_KEPT = 1000
"""Numbers whose times are remembered: no file is that many pictures behind another."""


class Pace:
    """Times of pictures by their numbers, each a period after the one before it; one that comes late delays the rest.

    The first who asks for a number fixes its time for all, so that files stay in step whatever delays one of them.
    """

    def __init__(self, files: int) -> None:
        """Nothing is due before so many files are open."""
        self._lock = threading.Lock()
        self._awaited = files
        self.begun = threading.Event()
        if not files:
            self.begun.set()
        self._due: dict[tuple[float, int], int] = {}

    def opened(self) -> None:
        """One more file is open, or will never be."""
        with self._lock:
            self._awaited -= 1
            if self._awaited <= 0:
                self.begun.set()

    def due_ns(self, fps: float, number: int, now_ns: int) -> int:
        """When a picture is to be taken.

        Args:
            fps: pictures a second; files of one rate are in step.
            number: of the picture, from 0.
            now_ns: on the clock of what is returned.
        """
        with self._lock:
            key, period_ns = (fps, number), round(NS_PER_S / fps)
            if key not in self._due:
                due_ns = self._due.get((fps, number - 1), now_ns - period_ns) + period_ns
                self._due[key] = now_ns if now_ns - due_ns > period_ns else due_ns
                self._due.pop((fps, number - _KEPT), None)
            return self._due[key]
