"""The last word before a command: why the arm must not move now, and whether a setpoint keeps every limit."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from armsight.v1.safety_pb2 import StopState
from armsight_control.bodies import Seen
from armsight_control.chain import Array, Chain
from armsight_control.errors import ControlError, PositionsError
from armsight_control.kinematics import forward
from armsight_control.trajectory import MotionLimits

# Positions that waited longer in this process, by its own monotonic clock, say where the arm was, not where it is.
MAX_AGE_S = 0.1

# All distances are of an arm of 10 m, and smaller for a smaller one (Chain.scale).
# How far the tip may be from where the setpoint puts it: at rest, and per metre per second that it may move at
# (delays of camera, vision and actuators together).
_ASTRAY_AT_REST_M = 0.5
_ASTRAY_DELAY_S = 0.3

# What the tip may do between two instants that was not commanded: half-hidden markers jump by 0.1 m and more, and
# for every metre commanded a part comes an instant earlier or later.
_SURPRISE_M = 0.3
_SURPRISE_SIGMAS = 5.0
_SURPRISE_SHARE = 0.5
# The third instant in a row that says the same is right.
_SURPRISES = 2

SINGULAR_FROM_M = 0.5
"""Slower from here on towards a singularity (m/rad, the Jacobian's smallest singular value), down to a share."""
_SINGULAR_TO_M = 0.1
_SINGULAR_SHARE = 0.3

# Rounding of angles of some radians, and what it makes of second differences over a thirtieth of a second.
_ROUNDING_RAD = 1e-9
_ROUNDING_RAD_S = 1e-6


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
    allowed = _ASTRAY_AT_REST_M * chain.scale + _ASTRAY_DELAY_S * speed_share * _fastest_tip_m_s(chain)
    off = math.dist(tip, forward(chain, setpoint))
    if off > allowed:
        raise PositionsError("astray", f"the tip is {off:.1f} m from where the setpoint puts it: is the arm blocked?")


@lru_cache(maxsize=16)
def _fastest_tip_m_s(chain: Chain) -> float:
    """More than the tip ever moves at, with every joint at its greatest speed."""
    # of the way to joint 2 only what is off joint 1's axis swings
    off_axis = np.linalg.norm(np.cross(chain.axes[0], chain.origins[1])) if chain.count > 1 else 0.0
    reach = float(off_axis + np.linalg.norm(chain.origins[2:], axis=1).sum() + np.linalg.norm(chain.tip.position))
    return float(chain.max_speed.max()) * reach


@dataclass(frozen=True, slots=True)
class Expected:
    """The tip as it was last seen, and where it was commanded to be at that instant; base frame."""

    seen: Seen
    commanded: Array
    surprises: int = 0
    """Instants in a row, up to this one, whose tip was not where it could have got to."""


def expect(before: Expected | None, seen: Seen, commanded: Array, scale: float = 1.0) -> Expected:
    """Takes the tip of one more instant, and says where the innovation test stands.

    The tip is compared with where it was last believed to be, moved as it was commanded to: a marker that is taken for
    another jumps, whatever the arm does. The third surprise in a row is believed: the arm is there then.

    Args:
        before: the last instant; none at the start.
        seen: the tip.
        commanded: where it was to be.
        scale: of the arm, :attr:`~armsight_control.chain.Chain.scale`.
    """
    if before is None:
        return Expected(seen, commanded)
    moved = commanded - before.commanded
    surprise = math.hypot(*(seen.position - before.seen.position - moved).tolist())
    allowed = _SURPRISE_M * scale + _SURPRISE_SHARE * math.hypot(*moved.tolist())
    allowed += _SURPRISE_SIGMAS * (seen.sigma_m + before.seen.sigma_m)
    if surprise <= allowed or before.surprises >= _SURPRISES:
        return Expected(seen, commanded)
    return Expected(before.seen, before.commanded, before.surprises + 1)


def check_expected(expected: Expected) -> None:
    """Refuses positions whose tip is a surprise.

    Raises:
        PositionsError: it moved as nobody told it to.
    """
    if expected.surprises:
        raise PositionsError("innovation", "the tip jumped: is a marker taken for another?")


def slow_for_singularity(present_m: float, ahead_m: Callable[[], float], scale: float = 1.0) -> float:
    """Share of the speed limits to keep to, by the Jacobian's smallest singular value now and where the arm goes.

    The way out of a singularity is free.
    """
    most_m, least_m = SINGULAR_FROM_M * scale, _SINGULAR_TO_M * scale
    if present_m >= most_m or ahead_m() >= present_m:
        return 1.0
    into = (most_m - present_m) / (most_m - least_m)
    return max(_SINGULAR_SHARE, 1.0 - (1.0 - _SINGULAR_SHARE) * into)


@dataclass(frozen=True, slots=True)
class Pace:
    """The step to the setpoint in force: what the next one's acceleration is measured from."""

    velocity: Array
    """Mean over that step, rad/s."""
    dt_s: float


def check_setpoint(chain: Chain, limits: MotionLimits, before: Array, pace: Pace, setpoint: Array, dt_s: float) -> Pace:
    r"""Refuses a setpoint that breaks a limit; returns its own pace.

    Between two steps the mean velocity may change by :math:`a_{max} (dt_1 + dt_2)/2`: no motion within the
    acceleration can do more.

    Raises:
        UnsafeError: not finite, outside of the limits, faster than a joint may go, or sooner than it may get there.
    """
    angles = setpoint.tolist()
    if not all(map(math.isfinite, angles)):
        raise UnsafeError(f"setpoint {angles} is not finite")
    if any(angle < lower or angle > upper for angle, (lower, upper) in zip(angles, chain.bounds, strict=True)):
        raise UnsafeError(f"setpoint {angles} is outside of the limits")
    if dt_s <= 0:
        raise UnsafeError(f"setpoint {angles} is for no time at all")
    moved = [angle - was for angle, was in zip(angles, before.tolist(), strict=True)]
    farthest = [speed * dt_s + _ROUNDING_RAD for speed in limits.speed(chain).tolist()]
    if any(abs(way) > most for way, most in zip(moved, farthest, strict=True)):
        raise UnsafeError(f"setpoint {angles} is farther than the joints' speed allows in {dt_s:.3f} s")
    velocity = [way / dt_s for way in moved]
    allowed = limits.acceleration_rad_s2 * (dt_s + pace.dt_s) / 2 + _ROUNDING_RAD_S + 2 * _ROUNDING_RAD / dt_s
    if any(abs(now - was) > allowed for now, was in zip(velocity, pace.velocity.tolist(), strict=True)):
        raise UnsafeError(f"setpoint {angles} needs more than {limits.acceleration_rad_s2:g} rad/s²")
    return Pace(np.array(velocity), dt_s)


def stopped_by(stop: StopState | None) -> Hold | None:
    """Who has stopped the arm, if anybody has."""
    if stop is None or not stop.stopped:
        return None
    who = [f"{s.name} ({s.reason})" if s.reason else s.name for s in stop.sources if s.stopped]
    return Hold("stopped", f"stopped by {', '.join(who) or 'safety/stop'}: release it to move on")
