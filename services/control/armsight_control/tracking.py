r"""A moving target: from stamped points to where it will be when the arm gets there.

A Kalman filter of constant acceleration, per axis :math:`\dot{x} = v, \dot{v} = a, \dot{a} \sim` white noise (the
discrete white-noise-jerk model: Bar-Shalom, Li and Kirubarajan, Estimation with Applications, 2001, section 6.2). All
axes share one covariance of state. A point that no motion explains is another target, not a velocity.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from foxglove_schemas_protobuf.Point3InFrame_pb2 import Point3InFrame

from armsight.times import NS_PER_S
from armsight_control.chain import Array, Rows, Triple
from armsight_control.description import Arm
from armsight_control.errors import SolverError

_MAX_TARGET_M = 1e4
# Spectral density of the jerk, m²/s⁵: targets change acceleration by some 0.3 m/s³ over about a second.
_JERK_DENSITY = 0.1
# Of a target that is new: it may go at a metre a second or so, and accelerate as fast.
_NEW_SPEED_SIGMA = 1.0
_NEW_ACCELERATION_SIGMA = 1.0
# A point is another target where it lies this far off, and this much beyond what is known of the motion.
_JUMP_M = 0.3
_JUMP_SIGMAS = 5.0
# Without a point for this long the target is taken to rest at the last one.
FORESEEN_S = 0.5
# Stamps of a moving target are capture times: what is stamped otherwise says nothing of motion.
_SAME_CLOCK_S = 1.0


@dataclass(frozen=True, slots=True)
class Target:
    """Where the tip is to be, base frame, metres."""

    stamp_ns: int
    position: Array


def target_of(message: Point3InFrame, arm: Arm) -> Target:
    """Checks a target and takes it into the base frame.

    Raises:
        SolverError: another frame than `world` or `base`, or not finite.
    """
    point = finite_target(message.point.x, message.point.y, message.point.z)
    if message.frame_id == "world":
        point = arm.world_to_base(point)
    elif message.frame_id != "base":
        raise SolverError(f"target in frame {message.frame_id!r}: expected world or base")
    return Target(message.timestamp.seconds * 1_000_000_000 + message.timestamp.nanos, point)


def finite_target(x: float, y: float, z: float) -> Array:
    """A point as an array.

    Raises:
        SolverError: not finite, or farther away than any scene is large.
    """
    point = np.array([x, y, z])
    if not (np.abs(point) < _MAX_TARGET_M).all():
        raise SolverError(f"target ({x:g}, {y:g}, {z:g}) is not finite and within {_MAX_TARGET_M:g} m")
    return point


@dataclass(frozen=True, slots=True)
class Track:
    """What is known of a moving point at the instant of its last measurement; in plain floats."""

    stamp_ns: int
    state: tuple[Triple, Triple, Triple]
    """Position (m), velocity (m/s) and acceleration (m/s²), each along x, y, z."""
    covariance: Rows
    """3 x 3, of one axis' position, velocity and acceleration."""
    jumped: bool = False
    """The last point was that of another target."""


def begun(stamp_ns: int, position: Triple, sigma_m: float) -> Track:
    """A track of one point: how it moves is not known."""
    nothing = (0.0, 0.0, 0.0)
    speed2, acceleration2 = _NEW_SPEED_SIGMA**2, _NEW_ACCELERATION_SIGMA**2
    covariance = (sigma_m**2, 0.0, 0.0), (0.0, speed2, 0.0), (0.0, 0.0, acceleration2)
    return Track(stamp_ns, (position, nothing, nothing), covariance)


def observed(track: Track | None, stamp_ns: int, position: Array, sigma_m: float) -> Track:
    """The track after one more point.

    Args:
        track: so far, if there is one.
        stamp_ns: of the point; one that is not later than the track's last begins a new track where it differs.
        position: (3,), metres.
        sigma_m: standard deviation of the point, per axis.
    """
    x, y, z = position.tolist()
    place = (x, y, z)
    if track is None:
        return begun(stamp_ns, place, sigma_m)
    dt = (stamp_ns - track.stamp_ns) / NS_PER_S
    if dt <= 0 and place == track.state[0]:
        return replace(track, jumped=False)
    if not 0 < dt <= FORESEEN_S:
        moved = math.dist(place, track.state[0])
        return replace(begun(stamp_ns, place, sigma_m), jumped=moved > _JUMP_M)
    half = dt * dt / 2
    foreseen = [(x + dt * v + half * a, v + dt * a, a) for x, v, a in zip(*track.state, strict=True)]
    (xx, xv, xa), (_, vv, va), (_, _, aa) = _carried(track.covariance, dt)
    off, variance = math.dist(place, [x for x, _, _ in foreseen]), xx + sigma_m**2
    if off > _JUMP_M and off > _JUMP_SIGMAS * math.sqrt(variance):
        return replace(begun(stamp_ns, place, sigma_m), jumped=True)
    by_x, by_v, by_a = xx / variance, xv / variance, xa / variance  # the filter's gain
    axes = [
        (x + by_x * (seen - x), v + by_v * (seen - x), a + by_a * (seen - x))
        for seen, (x, v, a) in zip(place, foreseen, strict=True)
    ]
    at, speed, acceleration = zip(*axes, strict=True)
    vv, va, aa = vv - by_v * xv, va - by_v * xa, aa - by_a * xa
    xx, xv, xa = xx - by_x * xx, xv - by_x * xv, xa - by_x * xa
    return Track(stamp_ns, (at, speed, acceleration), ((xx, xv, xa), (xv, vv, va), (xa, va, aa)))


def _carried(covariance: Rows, dt: float) -> Rows:
    r""":math:`F P F^T + Q` over ``dt`` seconds, with F the transition and Q the noise; only its upper triangle."""
    half = dt * dt / 2
    (xx, xv, xa), (_, vv, va), (_, _, aa) = covariance
    # F P, of which the rows are
    xx, xv, xa = xx + dt * xv + half * xa, xv + dt * vv + half * va, xa + dt * va + half * aa
    vv, va = vv + dt * va, va + dt * aa
    # and that times F^T
    xx, xv, vv = xx + dt * xv + half * xa, xv + dt * xa, vv + dt * va
    q = _JERK_DENSITY
    return (
        (xx + q * dt**5 / 20, xv + q * dt**4 / 8, xa + q * dt**3 / 6),
        (0.0, vv + q * dt**3 / 3, va + q * dt**2 / 2),
        (0.0, 0.0, aa + q * dt),
    )


@dataclass(frozen=True, slots=True)
class Moving:
    """A point in motion: metres and metres per second."""

    position: Array
    velocity: Array


def predicted(track: Track, at_ns: int, now_ns: int, foreseen_s: float = FORESEEN_S) -> Moving:
    """Where the target will be.

    Args:
        track: what is known of it.
        at_ns: the instant asked for.
        now_ns: the capture time that is answered: a target that is not stamped on that clock rests where it was last.
        foreseen_s: so does one that was not heard of for longer.
    """
    x, v, a = np.array(track.state)
    since_s = (now_ns - track.stamp_ns) / NS_PER_S
    if not -_SAME_CLOCK_S <= since_s <= foreseen_s:
        return Moving(x, np.zeros(3))
    dt = (at_ns - track.stamp_ns) / NS_PER_S
    return Moving(x + v * dt + a * (dt * dt / 2), v + a * dt)
