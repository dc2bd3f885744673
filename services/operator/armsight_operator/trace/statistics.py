"""What many frames have in common: the middle and the slow end of each stage."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from armsight_operator.trace.stages import STAGES, TOTAL, Frame, Stage

WINDOW = 1000
"""Frames that statistics are of: the newest."""


@dataclass(frozen=True, slots=True)
class Summary:
    """One stage over the frames of a window; seconds. Nothing is known of a stage that no frame told of."""

    stage: Stage
    frames: int
    last_s: float | None
    p50_s: float | None
    p99_s: float | None


class Statistics:
    """The newest frames of a trace."""

    def __init__(self, window: int = WINDOW) -> None:
        """Knows nothing yet."""
        self._seconds: dict[str, deque[float]] = {stage.name: deque(maxlen=window) for stage in (*STAGES, TOTAL)}
        self.frames = 0
        self.contradicted = 0
        """Stages that ended before they began: clocks of two machines that differ."""
        self.last: Frame | None = None

    def add(self, frame: Frame) -> None:
        """Takes a frame."""
        self.frames += 1
        self.last = frame
        for stage in (*STAGES, TOTAL):
            took = frame.seconds(stage)
            self.contradicted += frame.contradicted(stage)
            if took is not None:
                self._seconds[stage.name].append(took)

    def summary(self, stage: Stage) -> Summary:
        """One stage."""
        ordered = sorted(self._seconds[stage.name])
        last = None if self.last is None else self.last.seconds(stage)
        return Summary(stage, len(ordered), last, _percentile(ordered, 0.50), _percentile(ordered, 0.99))

    def summaries(self) -> tuple[Summary, ...]:
        """Every stage in order, the whole last."""
        return tuple(self.summary(stage) for stage in (*STAGES, TOTAL))


def _percentile(ordered: Sequence[float], share: float) -> float | None:
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))] if ordered else None
