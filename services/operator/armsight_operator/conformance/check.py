"""A check: what the contract says, and what came of asking for it."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Generic, TypeVar

from armsight_operator.errors import OperatorError

Player = TypeVar("Player")


class Outcome(Enum):
    """What came of a check."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_APPLICABLE = "not applicable"


class UnfulfilledError(OperatorError):
    """The contract says otherwise."""

    def __init__(self, seen: str, expected: str) -> None:
        """Takes one line of each."""
        super().__init__(f"{seen}; expected {expected}")
        self.seen, self.expected = seen, expected


class NotApplicableError(OperatorError):
    """There is nothing to judge; the text says why."""


@dataclass(frozen=True, slots=True)
class Check(Generic[Player]):
    """One thing that the contract asks for."""

    name: str
    says: str
    """The contract, in one sentence."""
    stands: str
    """Where it says so."""
    run: Callable[[Player], None]
    """Raises :class:`UnfulfilledError` or :class:`NotApplicableError`; takes the other parts of the loop."""


@dataclass(frozen=True, slots=True)
class Result:
    """One check's outcome."""

    name: str
    says: str
    stands: str
    outcome: Outcome
    seen: str = ""
    """What was seen, or why it does not apply; empty where it passed."""
    expected: str = ""
    """Empty unless it failed."""
    took_s: float = 0.0

    def as_dict(self) -> dict[str, str | float]:
        """For ``--json``."""
        return {
            "check": self.name,
            "outcome": self.outcome.value,
            "seen": self.seen,
            "expected": self.expected,
            "contract": self.says,
            "where": self.stands,
            "seconds": round(self.took_s, 2),
        }


def require(fulfilled: bool, seen: str, expected: str) -> None:
    """Says what was seen instead of what was expected.

    Raises:
        UnfulfilledError: it is not fulfilled.
    """
    if not fulfilled:
        raise UnfulfilledError(seen, expected)
