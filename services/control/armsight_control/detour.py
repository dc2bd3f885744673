"""From a step that was planned to one that keeps the links away from the box."""

from dataclasses import dataclass

from armsight.v1.control_pb2 import SAFETY_CODE_HALTED_FOR_BODY, SAFETY_CODE_SLOWED_FOR_BODY, SafetyCode
from armsight_control.barrier import Capsule, allowed, clearances
from armsight_control.chain import Chain
from armsight_control.tracking import Moving
from armsight_control.trajectory import MotionLimits, Planner, State

KEEP_M = 0.8
"""Between any link's surface and the centre of the box."""

# What vision and the arm's response may be off by.
_MARGIN_M = 0.1


@dataclass(frozen=True, slots=True)
class Detour:
    """Another step than the one that was planned."""

    after: State
    code: SafetyCode
    detail: str


class Detours:
    """Of one arm under its limits."""

    def __init__(self, chain: Chain, limits: MotionLimits, planner: Planner, capsules: tuple[Capsule, ...]) -> None:
        """Shares the planner with whoever plans steps."""
        self._chain, self._planner, self._capsules = chain, planner, capsules
        self._most = limits.speed(chain)

    def clearance_m(self, state: State, box: Moving) -> float:
        """Of the nearest link's surface to the centre of the box."""
        return min(found.distance_m for found in clearances(self._chain, state.position, self._capsules, box.position))

    def around(self, box: Moving, state: State, planned: State, dt_s: float) -> Detour | None:
        """The step to take instead of the planned one; nothing where that keeps away from the box.

        Args:
            box: its centre, base frame, when the step ends.
            state: of the setpoint in force.
            planned: when the step ends.
            dt_s: how long the step is.
        """
        keep_m = KEEP_M + _MARGIN_M
        kept = allowed(self._chain, state.position, self._capsules, box, keep_m, planned.velocity, self._most)
        if not kept.slowed:
            return None
        if not kept.found:
            text = f"no motion keeps the links {KEEP_M:g} m from the box"
            return Detour(self._planner.brake(state, dt_s).state, SAFETY_CODE_HALTED_FOR_BODY, text)
        away = self._planner.at_speed(state, kept.velocity, dt_s).state
        return Detour(away, SAFETY_CODE_SLOWED_FOR_BODY, f"keeps {KEEP_M:g} m from the box")
