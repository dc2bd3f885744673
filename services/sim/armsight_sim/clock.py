"""Time of motion: which instant a frame belongs to, when the next one is due, when to ask again.

Nothing in here reads a clock: times come in as arguments.
"""

from dataclasses import dataclass
from enum import Enum

from armsight.times import NS_PER_S

WATCHDOG_S = 0.1
"""Simulated time without a fresh command to move after which the arm decelerates and holds."""


class ClockMode(Enum):
    """How simulated time passes."""

    REALTIME = "realtime"
    LOCKSTEP = "lockstep"


@dataclass(frozen=True, slots=True)
class Instants:
    """Capture times: Unix time at start plus simulated time since, never rewound."""

    start_ns: int
    fps: int

    def capture_ns(self, frame: int) -> int:
        """Instant of a frame, counted from 0."""
        return self.start_ns + frame * NS_PER_S // self.fps

    def elapsed_s(self, frame: int) -> float:
        """Simulated seconds from start to a frame."""
        return frame / self.fps


class Pacer:
    """Real time: frames at a fixed rate of the wall clock; one that comes late delays all that follow."""

    def __init__(self, fps: int, now_s: float) -> None:
        """The first frame is due now."""
        self._period_s = 1.0 / fps
        self._due_s = now_s

    @property
    def due_s(self) -> float:
        """When the next frame is due, on the clock of ``now_s``."""
        return self._due_s

    def taken(self, now_s: float) -> None:
        """Says that the frame that was due has been taken."""
        late = now_s - self._due_s > self._period_s
        self._due_s = (now_s if late else self._due_s) + self._period_s


class Lockstep:
    """Waits for the answer to one instant; says when to send its frames again."""

    # Longer than the 5 s for which a stalled reader is waited for by a blocking put.
    RESEND_AFTER_S = 6.0
    # A reader that has just appeared may not have subscribed yet: try more often for a while.
    EAGER_RESEND_S = 0.5
    EAGER_FOR_S = 6.0

    def __init__(self) -> None:
        """Waits for nothing yet."""
        self._sent_s = 0.0
        self._awaited_ns: int | None = None
        self._eager_until_s = 0.0

    @property
    def waiting(self) -> bool:
        """Whether an answer is owed."""
        return self._awaited_ns is not None

    def sent(self, capture_ns: int, now_s: float) -> None:
        """The frames of an instant are out, for the first time or again."""
        self._awaited_ns, self._sent_s = capture_ns, now_s

    def answered(self, answers_ns: int) -> bool:
        """Takes the instant that a command answers; returns whether it is the awaited one."""
        if answers_ns != self._awaited_ns:
            return False
        self._awaited_ns = None
        return True

    def reader_appeared(self, now_s: float) -> None:
        """Vision or control is there (again): what they missed must be sent again."""
        self._eager_until_s = now_s + self.EAGER_FOR_S

    def resend_due(self, now_s: float) -> bool:
        """Whether to send the frames again."""
        patience = self.EAGER_RESEND_S if now_s < self._eager_until_s else self.RESEND_AFTER_S
        return self.waiting and now_s - self._sent_s > patience
