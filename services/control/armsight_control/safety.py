"""The last word before a command: why the arm must not move now, and whether a setpoint keeps every limit."""

from dataclasses import dataclass

import numpy as np

from armsight.v1.safety_pb2 import StopState
from armsight_control.chain import Array, Chain
from armsight_control.errors import ControlError, PositionsError
from armsight_control.kinematics import forward

# Positions that waited longer in this process, by its own monotonic clock, say where the arm was, not where it is.
MAX_AGE_S = 0.1

# How far the tip may be from where the setpoint puts it: at rest, and per metre per second that it may move at
# (delays of camera, vision and actuators together).
_ASTRAY_AT_REST_M = 0.5
_ASTRAY_DELAY_S = 0.3

_ROUNDING_RAD = 1e-9


class UnsafeError(ControlError):
    """A setpoint that must not be sent."""


@dataclass(frozen=True, slots=True)
class Hold:
    """Why nothing moves."""

    reason: str
    """For counters."""
    detail: str
    """For a person."""


def check_age(age_s: float) -> None:
    """Refuses positions that waited too long.

    Raises:
        PositionsError: they are stale.
    """
    if not 0 <= age_s <= MAX_AGE_S:
        raise PositionsError("stale", f"positions waited {age_s:.2f} s before they were answered: is the machine busy?")


def check_astray(chain: Chain, setpoint: Array, tip: Array, speed_share: float) -> None:
    """Refuses positions that show the arm far from its setpoint.

    Raises:
        PositionsError: the tip is farther off than any delay explains.
    """
    expected = forward(chain, setpoint)
    # joint 1 carries joint 2 on its own axis: what swings begins after it
    reach = float(np.linalg.norm(chain.origins[2:], axis=1).sum() + np.linalg.norm(chain.tip.position))
    allowed = _ASTRAY_AT_REST_M + _ASTRAY_DELAY_S * speed_share * float(chain.max_speed.max()) * reach
    off = float(np.linalg.norm(tip - expected))
    if off > allowed:
        raise PositionsError("astray", f"the tip is {off:.1f} m from where the setpoint puts it: is the arm blocked?")


def check_setpoint(chain: Chain, before: Array, setpoint: Array, dt_s: float) -> None:
    """Refuses a setpoint that breaks a limit.

    Raises:
        UnsafeError: not finite, outside of the limits, or faster than a joint may go.
    """
    if not np.isfinite(setpoint).all():
        raise UnsafeError(f"setpoint {setpoint.tolist()} is not finite")
    if (setpoint < chain.limits[:, 0]).any() or (setpoint > chain.limits[:, 1]).any():
        raise UnsafeError(f"setpoint {setpoint.tolist()} is outside of the limits")
    if (np.abs(setpoint - before) > chain.max_speed * dt_s + _ROUNDING_RAD).any():
        raise UnsafeError(f"setpoint {setpoint.tolist()} is farther than the joints' speed allows in {dt_s:.3f} s")


def stopped_by(stop: StopState | None) -> Hold | None:
    """Who has stopped the arm, if anybody has."""
    if stop is None or not stop.stopped:
        return None
    who = [f"{s.name} ({s.reason})" if s.reason else s.name for s in stop.sources if s.stopped]
    return Hold("stopped", f"stopped by {', '.join(who) or 'safety/stop'}: release it to move on")
