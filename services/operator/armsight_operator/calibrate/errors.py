"""What calibration refuses: nothing is written then."""

from armsight_operator.errors import OperatorError


class UndeterminedError(OperatorError):
    """The pictures don't determine the answer; says what to record."""
