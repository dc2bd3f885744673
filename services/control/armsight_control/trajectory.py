r"""From a goal to setpoints: the report's sinusoids, and motion towards a goal under the joints' speed limits.

Setpoints are absolute and begin at the setpoint in force. All joints are scaled together, so that the arm moves along
the straight line in joint space: it never takes a way through the twin.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from armsight.times import NS_PER_S
from armsight_control.chain import Array, Chain
from armsight_control.errors import ControlError

# One hundredth of a millimetre at the tip: what is nearer is there.
ARRIVED_RAD = 1e-6


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """How fast the arm may go towards a goal."""

    speed_share: float = 0.3
    """Of each joint's greatest speed."""
    ramp_s: float = 0.25
    """From rest to that speed, and back."""

    def __post_init__(self) -> None:
        """Refuses what no motion can keep."""
        if not 0 < self.speed_share <= 1:
            raise ControlError(f"speed {self.speed_share} is not a share of the joints' speed: above 0, at most 1")
        if not 0.01 <= self.ramp_s <= 10:
            raise ControlError(f"ramp {self.ramp_s} s is not between 0.01 and 10 s")


@dataclass(frozen=True, slots=True)
class Motion:
    """What motion remembers from one answer to the next; the default is at rest."""

    speed: float = 0.0
    """Reached so far, 0 to 1 of the speed that is allowed."""


def part1_motion(t: float) -> Array:
    """The report's Part I motion at ``t`` seconds: joint 1 at 0."""
    return np.array([0.0, _sine(t, 15), _sine(t, 20), _sine(t, 18)]) * (math.pi / 2)


def part2_motion(t: float) -> Array:
    """The report's Part II motion at ``t`` seconds: joint 2 at 0."""
    return np.array([2 * _sine(t, 28), 0.0, _sine(t, 20), _sine(t, 18)]) * (math.pi / 2)


def all_motion(t: float) -> Array:
    """All joints at once at ``t`` seconds: half periods of 10 s times square roots of primes never meet again."""
    half_periods = (10 * math.sqrt(prime) for prime in (7, 2, 5, 3))
    return np.array([2, 1, 1, 1]) * [_sine(t, half_period) for half_period in half_periods] * (math.pi / 2)


def _sine(t: float, half_period_s: float) -> float:
    return math.sin(math.pi * t / half_period_s)


def towards(
    chain: Chain, setpoint: Array, goal: Array, dt_s: float, motion: Motion, limits: MotionLimits
) -> tuple[Array, Motion]:
    r"""The next setpoint on the straight line to the goal.

    With d the time that the slowest joint needs at full speed, the speed rises by :math:`dt / ramp` an answer up to
    :math:`\min(1, \sqrt{2 d / ramp})`, from which it can still stop in time. The goal is clipped to the limits.

    Args:
        chain: the arm.
        setpoint: in force now.
        goal: where to; may move from answer to answer.
        dt_s: of simulated time since the last answer.
        motion: what this function returned last, or at rest.
        limits: how fast.
    """
    goal = chain.clip(goal)
    remaining = goal - setpoint
    time_left = float(np.max(np.abs(remaining) / (chain.max_speed * limits.speed_share)))
    if time_left * limits.speed_share * float(chain.max_speed.max()) <= ARRIVED_RAD:
        return goal, Motion()
    speed = min(1.0, motion.speed + dt_s / limits.ramp_s, math.sqrt(2 * time_left / limits.ramp_s))
    share = min(1.0, speed * dt_s / time_left)
    if share >= 1.0:
        return goal, Motion(speed=min(1.0, time_left / dt_s))
    return setpoint + share * remaining, Motion(speed)


Path = Callable[[float], Array]


@dataclass(frozen=True, slots=True)
class Step:
    """One answer's place in time."""

    capture_ns: int
    dt_s: float
    """Of simulated time since the last answer."""


@dataclass(frozen=True, slots=True)
class OnPath:
    """Where a test's motion is on its time axis."""

    time_s: float
    """Of the last point commanded, or the one to begin at."""
    anchor: tuple[int, float] | None = None
    """Capture time and the time on the axis at it, while the arm is on the path."""

    def left(self) -> "OnPath":
        """The same point, with the arm no longer on its way along the path."""
        return replace(self, anchor=None)


def along(
    chain: Chain, path: Path, state: OnPath, setpoint: Array, step: Step, motion: Motion, limits: MotionLimits
) -> tuple[Array, OnPath, Motion]:
    """The next setpoint of a test.

    Time on the axis is ``anchor's + (capture - anchor's capture)`` while the arm is on the path. An arm that is not
    there first moves to where the test begins, or was interrupted.
    """
    if state.anchor is not None:
        anchor_ns, anchor_s = state.anchor
        time_s = anchor_s + (step.capture_ns - anchor_ns) / NS_PER_S
        point = chain.clip(path(time_s))
        if np.all(np.abs(point - setpoint) <= chain.max_speed * step.dt_s):
            return point, OnPath(time_s, state.anchor), motion
    begin = chain.clip(path(state.time_s))
    if np.abs(begin - setpoint).max() <= ARRIVED_RAD:
        return begin, OnPath(state.time_s, (step.capture_ns, state.time_s)), Motion()
    setpoint, motion = towards(chain, setpoint, begin, step.dt_s, motion, limits)
    return setpoint, state.left(), motion
