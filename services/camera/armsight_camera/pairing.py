"""Which frames of several cameras are of one instant.

Times are integer nanoseconds of one clock; nothing in here reads a clock. Each camera's frames come in order, those of
different cameras in any.
"""

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

F = TypeVar("F")


@dataclass(frozen=True, slots=True)
class Instant(Generic[F]):
    """Frames that go out under one time: that of the first of them."""

    time_ns: int
    skew_ns: int
    """From the first to the last of them."""
    frames: Mapping[str, F]
    """By camera."""


class Pairing(Generic[F]):
    """Gathers frames into instants, whose times only go up.

    An instant is the oldest frame that waits and, of every other camera, its oldest one if it is no farther than the
    skew. It is complete when no camera that is there can add to it: each has its frame in it, or one that is too late
    for it already. One that stays silent is waited for until the patience ends.
    """

    def __init__(self, cameras: Iterable[str], max_skew_ns: int, patience_ns: int) -> None:
        """Waits for nothing yet; all cameras are there.

        Args:
            cameras: their names.
            max_skew_ns: that frames of one instant may be apart.
            patience_ns: how old the first frame of an instant may become; not shorter than the skew and what lies
                between a frame's time and its coming here.
        """
        self.max_skew_ns, self.patience_ns = max_skew_ns, patience_ns
        self._waiting: dict[str, deque[tuple[int, F]]] = {camera: deque() for camera in cameras}
        self._newest_ns: dict[str, int] = {}
        self._taken_ns: int | None = None
        self._absent: set[str] = set()

    def add(self, camera: str, time_ns: int, frame: F) -> bool:
        """Takes a frame, unless it is too late: of an instant that is out, or not after its camera's last one."""
        newest, taken = self._newest_ns.get(camera), self._taken_ns
        if (newest is not None and time_ns <= newest) or (taken is not None and time_ns <= taken):
            return False
        self._newest_ns[camera] = time_ns
        self._waiting[camera].append((time_ns, frame))
        return True

    def present(self, camera: str, here: bool) -> None:
        """Says whether a camera is there: one that is not is not waited for."""
        (self._absent.discard if here else self._absent.add)(camera)

    def take(self, now_ns: int) -> Instant[F] | None:
        """The next instant that is complete or has waited long enough; none: not yet."""
        heads = {camera: waiting[0][0] for camera, waiting in self._waiting.items() if waiting}
        if not heads:
            return None
        first_ns = min(heads.values())
        awaited = self._waiting.keys() - heads.keys() - self._absent
        if awaited and now_ns - first_ns < self.patience_ns:
            return None
        mine = [camera for camera, time_ns in heads.items() if time_ns - first_ns <= self.max_skew_ns]
        self._taken_ns = first_ns
        frames = {camera: self._waiting[camera].popleft()[1] for camera in mine}
        return Instant(first_ns, max(heads[camera] for camera in mine) - first_ns, frames)

    def due_ns(self) -> int | None:
        """When the oldest frame has waited long enough; none: there is none."""
        heads = [waiting[0][0] for waiting in self._waiting.values() if waiting]
        return min(heads) + self.patience_ns if heads else None
