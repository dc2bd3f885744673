"""Whether this machine can run armsight, and what to do where it can't."""

from armsight_operator.doctor.examine import examine
from armsight_operator.doctor.finding import Finding, Level

__all__ = ["Finding", "Level", "examine"]
