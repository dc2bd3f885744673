"""What every solver takes and returns."""

from dataclasses import dataclass
from enum import Enum

from armsight_control.chain import Array, Chain
from armsight_control.errors import ControlError


class Status(Enum):
    """How a solve ended."""

    CONVERGED = "converged"
    STEP_LIMIT = "step limit"
    """Ran out of steps above the tolerance."""
    OUT_OF_REACH = "out of reach"
    """No configuration reaches the target: the solution is for the nearest point that one does."""


@dataclass(frozen=True, slots=True)
class Options:
    """The report's descent, section 4.2; a solver uses those that concern it."""

    alpha: float = 0.01
    """Step size."""
    tolerance_m: float = 0.005
    """Of the mean absolute error over x, y and z."""
    max_steps: int = 500

    def __post_init__(self) -> None:
        """Refuses what can't work."""
        if not 0 < self.alpha <= 1:
            raise ControlError(f"alpha {self.alpha} is not above 0 and at most 1")
        if not 0 < self.tolerance_m <= 1:
            raise ControlError(f"tolerance {self.tolerance_m} m is not above 0 and at most 1 m")
        if not 1 <= self.max_steps <= 100_000:
            raise ControlError(f"{self.max_steps} steps are not between 1 and 100000")


@dataclass(frozen=True, slots=True)
class Problem:
    """One target for the tip."""

    chain: Chain
    target: Array
    """Base frame, metres."""
    start: Array
    """All joints, radians; always inside the limits once solved."""
    options: Options = Options()


@dataclass(frozen=True, slots=True)
class Solution:
    """Where a solver went."""

    q: Array
    """All joints, radians, inside the limits."""
    tip: Array
    """Of that configuration, base frame."""
    residual_m: float
    """Euclidean distance of tip and target."""
    iterations: int
    status: Status
    converged: bool
    """Whether the tip is where the solver meant to put it: at the target, or at the reachable point nearest to it."""
