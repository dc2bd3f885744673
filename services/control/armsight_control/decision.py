"""What one instant is answered with: a setpoint, or why there is none."""

from dataclasses import dataclass

from armsight.v1.control_pb2 import (
    CONTROL_STATE_HOLDING,
    SAFETY_CODE_IMPLAUSIBLE,
    SAFETY_CODE_LOST,
    SAFETY_CODE_OK,
    SAFETY_CODE_STALE,
    ControlState,
    SafetyCode,
)
from armsight_control.chain import Array


@dataclass(frozen=True, slots=True)
class Decision:
    """Where to, or why not."""

    state: ControlState
    detail: str
    """One line for a person."""
    setpoint: Array | None = None
    reason: str = ""
    """One word for the counters, where nothing moves."""
    safety: SafetyCode = SAFETY_CODE_OK


def holding(detail: str, reason: str = "", safety: SafetyCode = SAFETY_CODE_OK) -> Decision:
    """Nothing is to move."""
    return Decision(CONTROL_STATE_HOLDING, detail, reason=reason, safety=safety)


_BLIND: dict[str, SafetyCode] = {"stale": SAFETY_CODE_STALE, "lost": SAFETY_CODE_LOST, "vague": SAFETY_CODE_LOST}


def blind_code(reason: str) -> SafetyCode:
    """The code for positions that can't be used, by a PositionsError's reason."""
    return _BLIND.get(reason, SAFETY_CODE_IMPLAUSIBLE)
