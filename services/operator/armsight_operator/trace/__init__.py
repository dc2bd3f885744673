"""Where the time of a frame went: its instants, the stages between them, and their statistics."""

from armsight_operator.trace.stages import KEYS, STAGES, TOTAL, Frame, Joiner, Stage, instants_of
from armsight_operator.trace.statistics import Statistics, Summary

__all__ = ["KEYS", "STAGES", "TOTAL", "Frame", "Joiner", "Stage", "Statistics", "Summary", "instants_of"]
