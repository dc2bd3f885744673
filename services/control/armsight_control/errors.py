"""Errors of this package: what was wrong, what was expected, what to do."""

from armsight.errors import ArmsightError


class ControlError(ArmsightError):
    """Base of every error that control raises on purpose."""


class DescriptionError(ControlError):
    """An ArmDescription that is not a serial chain of revolute joints."""


class UnsupportedArmError(ControlError):
    """A good chain, but not of the report's shape: its formulas don't apply."""


class JointCountError(ControlError):
    """A configuration with another number of joints than the arm."""


class PositionsError(ControlError):
    """Joint positions that can't be used; ``reason`` names why in counters."""

    def __init__(self, reason: str, text: str) -> None:
        """``reason`` is one word for a counter, ``text`` one line for a person."""
        super().__init__(text)
        self.reason = reason


class SetpointError(ControlError):
    """A configuration that is incomplete, not finite or outside of the limits."""


class ModeError(ControlError):
    """A mode that can't be taken now."""


class SolverError(ControlError):
    """A target that can't be solved: unknown solver, bad target, or the solver is not there."""


class OwnPartError(ControlError):
    """A part of a person's own that can't be loaded, or gives back what is no answer."""
