"""The last half minute as columns of numbers, for the plots."""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np
import numpy.typing as npt

from armsight.v1.joints_pb2 import StageTimes
from armsight_operator.trace.stages import STAGES as TRACED
from armsight_operator.trace.stages import instants_of

Column = npt.NDArray[np.float64]

WINDOW_S = 30.0

STAGES = ("camera to vision", "vision", "vision to control", "control")
"""What the page calls those that the services themselves tell."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One moment."""

    at_s: float
    """Monotonic clock."""
    estimated: Mapping[str, float]
    """Joint angles by name, rad."""
    true: Mapping[str, float]
    """Of the same instant; empty where nobody tells."""
    tip_error_m: float | None
    """Of the estimated tip from the true one."""
    stages_ms: tuple[float, ...] | None
    """In the order of :data:`STAGES`."""


def stages_ms(times: StageTimes) -> tuple[float, ...] | None:
    """How long each stage took, milliseconds; nothing where one was not passed.

    Between stages on several machines the difference of their clocks is in it.
    """
    told = instants_of(times)
    passed = [stage for stage in TRACED if not stage.heard]
    if not all(stage.begin in told and stage.end in told for stage in passed):
        return None
    return tuple((told[stage.end] - told[stage.begin]) / 1e6 for stage in passed)


def known(times: Column, columns: Sequence[Column]) -> tuple[Column, ...]:
    """Times and columns without the moments at which something is unknown: uPlot draws nothing at all where one is."""
    table = np.stack([times, *columns])
    return tuple(table[:, np.isfinite(table).all(axis=0)])


class History:
    """Samples of the last :data:`WINDOW_S` seconds."""

    def __init__(self) -> None:
        """Empty."""
        self._samples: deque[Sample] = deque()

    def add(self, sample: Sample) -> None:
        """Takes a sample and forgets what is too old."""
        self._samples.append(sample)
        while sample.at_s - self._samples[0].at_s > WINDOW_S:
            self._samples.popleft()

    def times(self) -> Column:
        """Seconds before the newest sample, ascending to 0."""
        newest = self._samples[-1].at_s if self._samples else 0.0
        return np.array([sample.at_s - newest for sample in self._samples])

    def angles(self, names: tuple[str, ...]) -> list[Column]:
        """Estimated, then true, for one joint after the other; NaN where unknown.

        Where nobody ever told the truth, the estimate stands for it: there is one line to be seen.
        """
        estimated = [s.estimated for s in self._samples]
        true = [s.true for s in self._samples] if any(s.true for s in self._samples) else estimated
        return [
            np.array([angles.get(name, math.nan) for angles in source])
            for name in names
            for source in (estimated, true)
        ]

    def tip_error_mm(self) -> Column:
        """NaN where unknown."""
        return np.array([math.nan if s.tip_error_m is None else 1000 * s.tip_error_m for s in self._samples])

    def stages(self) -> list[Column]:
        """Milliseconds of each stage; NaN where unknown."""
        unknown = (math.nan,) * len(STAGES)
        return [np.array([(s.stages_ms or unknown)[index] for s in self._samples]) for index in range(len(STAGES))]

    def stage_medians_ms(self) -> tuple[float, ...] | None:
        """Over the window; nothing before the first."""
        known = [sample.stages_ms for sample in self._samples if sample.stages_ms is not None]
        return tuple(median(column) for column in zip(*known, strict=True)) if known else None
