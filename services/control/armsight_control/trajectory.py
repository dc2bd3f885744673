r"""From a goal to setpoints that no joint can't follow: bounded in position, speed, acceleration and jerk.

At every answer the way to the goal is planned anew from the state of the setpoint in force (Berscheid and Kröger,
Jerk-limited Real-time Trajectory Generation with Arbitrary Target States, 2021: the package ruckig), and one step of it
is taken. A goal that moves is planned to in its own frame, :math:`\tilde q = q - q_{goal} - \dot q_{goal} t`, where it
rests: the plan meets it where it will be, and a setpoint that is there keeps up with it without a lag.

The joint limits are kept by induction: a step is taken only where braking after it ends within them; else the joint
brakes, as the step before has left room for.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from ruckig import (
    ControlInterface,
    InputParameter,
    Result,
    Ruckig,
    RuckigError,
    Synchronization,
    Trajectory,
)

from armsight.times import NS_PER_S
from armsight_control.chain import Array, Chain, farthest
from armsight_control.errors import ControlError

# One hundredth of a millimetre at the tip: what is nearer is there.
ARRIVED_RAD = 1e-6
# A goal may move with up to this share of the speed that is allowed: the rest is for catching up with it.
_GOAL_SHARE = 0.9
# An arm that is farther from a test's path was interrupted: it goes back to where it left.
_OFF_PATH_RAD = 0.3
_DERIVATIVE_S = 1e-4


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """How fast the arm may go."""

    speed_share: float = 0.3
    """Of each joint's greatest speed."""
    acceleration_rad_s2: float = 6.0
    """A third of what sim's setpoint allows (20): its actuators follow without saturating. 1.5 rad/s in a quarter
    of a second."""
    jerk_rad_s3: float = 60.0
    """The acceleration builds up in a tenth of a second, three frames: faster than that frames can't show."""

    def __post_init__(self) -> None:
        """Refuses what no motion can keep."""
        if not 0 < self.speed_share <= 1:
            raise ControlError(f"speed {self.speed_share} is not a share of the joints' speed: above 0, at most 1")
        if not 0.01 <= self.acceleration_rad_s2 <= 1e3:
            raise ControlError(f"acceleration {self.acceleration_rad_s2} rad/s² is not between 0.01 and 1000 rad/s²")
        if not 0.01 <= self.jerk_rad_s3 <= 1e5:
            raise ControlError(f"jerk {self.jerk_rad_s3} rad/s³ is not between 0.01 and 100000 rad/s³")

    def speed(self, chain: Chain) -> Array:
        """Of each joint, rad/s."""
        return np.asarray(chain.max_speed * self.speed_share)


@dataclass(frozen=True, slots=True)
class State:
    """The setpoint in motion: n angles in rad, with their first and second derivatives."""

    position: Array
    velocity: Array
    acceleration: Array

    @property
    def at_rest(self) -> bool:
        """Whether it stays where it is."""
        return not (self.velocity.any() or self.acceleration.any())

    def before(self, seconds: float) -> Array:
        """Where it was a little earlier (or will be, with negative seconds)."""
        return np.asarray(self.position - seconds * self.velocity + seconds * seconds / 2 * self.acceleration)


def at_rest(q: Array) -> State:
    """A setpoint that does not move."""
    return State(q, np.zeros_like(q), np.zeros_like(q))


@dataclass(frozen=True, slots=True)
class Goal:
    """Where to be when the step ends, and how fast that moves."""

    position: Array
    velocity: Array


def resting(q: Array) -> Goal:
    """A goal that does not move."""
    return Goal(q, np.zeros_like(q))


@dataclass(frozen=True, slots=True)
class Stepped:
    """The setpoint after one step."""

    state: State
    braked: tuple[bool, ...]
    """Joints that would else have passed a limit."""


@dataclass(frozen=True, slots=True)
class _Plan:
    """What the way in hand was planned from, and how far it is done."""

    goal: Goal
    slow: float
    done_s: float
    state: State


class Planner:
    """One arm's bounds, and the way in hand to a goal that rests.

    A goal that stays what it was is not planned to anew: from rest the way is straight in joint space, and a new plan
    from its middle would be so but for rounding, on which it depends.
    """

    def __init__(self, chain: Chain, limits: MotionLimits) -> None:
        """Sets up the planner's memory once."""
        self._chain, self._limits = chain, limits
        self._speed = limits.speed(chain)
        self._speeds: list[float] = self._speed.tolist()
        self._planner = Ruckig(chain.count)
        self._way, self._stop = Trajectory(chain.count), Trajectory(chain.count)
        self._plan: _Plan | None = None
        self._to_goal, self._to_speed = self._inputs(), self._inputs()
        self._to_goal.synchronization = Synchronization.Phase  # straight in joint space where it starts at rest
        self._to_speed.control_interface = ControlInterface.Velocity
        self._to_speed.synchronization = Synchronization.No

    def towards(self, state: State, goal: Goal, dt_s: float, slow: float = 1.0) -> Stepped:
        """One step towards a goal.

        Args:
            state: of the setpoint in force.
            goal: at the end of this step.
            dt_s: how long the step is.
            slow: share of the speed limits to keep to, above 0: a setpoint that is faster slows down first.
        """
        goal = self._kept(goal, slow)
        done_s = self._done(state, goal, slow)
        if done_s == 0.0 and not self._plan_to(goal, state, dt_s, slow):
            return self.brake(state, dt_s)
        at = _at(self._way, done_s + dt_s)
        there = State(at.position + goal.position, at.velocity + goal.velocity, at.acceleration)
        stepped = self._within_limits(state, there, dt_s)
        self._plan = None if any(stepped.braked) else _Plan(goal, slow, done_s + dt_s, stepped.state)
        return stepped

    def _kept(self, goal: Goal, slow: float) -> Goal:
        """The goal within the limits, no faster than can be kept up with; at rest where it is beyond a limit."""
        position, moving = [], []
        goals = zip(goal.position.tolist(), goal.velocity.tolist(), self._speeds, self._chain.bounds, strict=True)
        for angle, rate, speed, (lower, upper) in goals:
            inside = min(max(angle, lower), upper)
            most = _GOAL_SHARE * (speed * slow) if inside == angle else 0.0
            position.append(inside)
            moving.append(min(max(rate, -most), most))
        return Goal(np.array(position), np.array(moving))

    def _plan_to(self, goal: Goal, state: State, dt_s: float, slow: float) -> bool:
        """Plans the way to the goal of this step, in the goal's own frame; false where there is none."""
        plan, moving, speeds = self._to_goal, goal.velocity.tolist(), [speed * slow for speed in self._speeds]
        ways = zip(state.position.tolist(), goal.position.tolist(), moving, strict=True)
        plan.current_position = [angle - there + rate * dt_s for angle, there, rate in ways]
        plan.current_velocity = [now - rate for now, rate in zip(state.velocity.tolist(), moving, strict=True)]
        plan.current_acceleration = state.acceleration.tolist()
        plan.max_velocity = [speed - rate for speed, rate in zip(speeds, moving, strict=True)]
        plan.min_velocity = [-speed - rate for speed, rate in zip(speeds, moving, strict=True)]
        return self._calculate(plan, self._way)

    def _done(self, state: State, goal: Goal, slow: float) -> float:
        """Seconds of the way in hand that are done; 0 where it is not the way from this state to this goal."""
        plan = self._plan
        if plan is None or plan.state is not state or plan.slow != slow or goal.velocity.any():
            return 0.0
        same = np.array_equal(plan.goal.position, goal.position) and not plan.goal.velocity.any()
        return plan.done_s if same else 0.0

    def at_speed(self, state: State, velocity: Array, dt_s: float) -> Stepped:
        """One step on the way to a velocity."""
        there = self._towards_speed(state, np.clip(velocity, -self._speed, self._speed), dt_s)
        return self.brake(state, dt_s) if there is None else self._within_limits(state, there, dt_s)

    def brake(self, state: State, dt_s: float) -> Stepped:
        """One step of coming to rest as fast as acceleration and jerk allow."""
        there = self._towards_speed(state, np.zeros_like(state.velocity), dt_s)
        braked = (False,) * self._chain.count
        return Stepped(at_rest(state.position) if there is None else self._clipped(there), braked)

    def _within_limits(self, state: State, there: State, dt_s: float) -> Stepped:
        passed = self._passes_limit(there)
        if not any(passed):
            return Stepped(there, (False,) * self._chain.count)
        stop = self.brake(state, dt_s).state
        kept = self._clipped(
            State(
                np.where(passed, stop.position, there.position),
                np.where(passed, stop.velocity, there.velocity),
                np.where(passed, stop.acceleration, there.acceleration),
            )
        )
        return Stepped(kept, tuple(passed))

    def _passes_limit(self, state: State) -> list[bool]:
        """Which joints would pass a limit if they braked from here."""
        if not self._plan_speed(state, [0.0] * self._chain.count):
            return [True] * self._chain.count
        bounds = zip(self._stop.position_extrema, self._chain.bounds, strict=True)
        return [way.min < lower or way.max > upper for way, (lower, upper) in bounds]

    def _clipped(self, state: State) -> State:
        # rounding alone: braking was found to end within the limits before this motion was begun
        return replace(state, position=self._chain.clip(state.position))

    def _towards_speed(self, state: State, velocity: Array, dt_s: float) -> State | None:
        return _at(self._stop, dt_s) if self._plan_speed(state, velocity.tolist()) else None

    def _plan_speed(self, state: State, velocity: list[float]) -> bool:
        plan = self._to_speed
        plan.current_position = state.position.tolist()
        plan.current_velocity = state.velocity.tolist()
        plan.current_acceleration = state.acceleration.tolist()
        plan.target_velocity = velocity
        return self._calculate(plan, self._stop)

    def _calculate(self, plan: InputParameter, trajectory: Trajectory) -> bool:
        try:
            return self._planner.calculate(plan, trajectory) in (Result.Working, Result.Finished)
        except RuckigError:
            return False

    def _inputs(self) -> InputParameter:
        inputs, zeros = InputParameter(self._chain.count), [0.0] * self._chain.count
        inputs.target_position = inputs.target_velocity = inputs.target_acceleration = zeros
        inputs.max_velocity = self._speed.tolist()
        inputs.max_acceleration = [self._limits.acceleration_rad_s2] * self._chain.count
        inputs.max_jerk = [self._limits.jerk_rad_s3] * self._chain.count
        return inputs


def _at(trajectory: Trajectory, seconds: float) -> State:
    position, velocity, acceleration = trajectory.at_time(seconds)
    return State(np.array(position), np.array(velocity), np.array(acceleration))


# --- the report's tests

Path = Callable[[float], Array]


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


def all_motion_of(limits: Array) -> Path:
    """All joints at once of any arm, each from limit to limit; as with :func:`all_motion` they never meet again.

    Args:
        limits: n x 2, radians: lower, upper.
    """
    lower, upper = limits.T
    half_periods = [10 * math.sqrt(prime) for prime in _primes(len(limits))]

    def motion(t: float) -> Array:
        swings = np.array([_sine(t, half_period) for half_period in half_periods])
        return np.asarray(np.clip((lower + upper) / 2 + swings * (upper - lower) / 2, lower, upper))

    return motion


def _primes(count: int) -> list[int]:
    """From 2 on."""
    found: list[int] = []
    number = 2
    while len(found) < count:
        if all(number % prime for prime in found):
            found.append(number)
        number += 1
    return found


def _sine(t: float, half_period_s: float) -> float:
    return math.sin(math.pi * t / half_period_s)


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


def along(path: Path, where: OnPath, state: State, step: Step) -> tuple[Goal, OnPath]:
    """The goal of this step on a test's path.

    Time on the axis is ``anchor's + (capture - anchor's capture)`` while the arm is on the path. An arm that is not
    there first moves to where the test begins, or was interrupted, and starts from rest.
    """
    if where.anchor is not None:
        anchor_ns, anchor_s = where.anchor
        time_s = anchor_s + (step.capture_ns - anchor_ns) / NS_PER_S
        there = path(time_s)
        if farthest(there, state.position) <= _OFF_PATH_RAD:
            velocity = (path(time_s + _DERIVATIVE_S) - path(time_s - _DERIVATIVE_S)) / (2 * _DERIVATIVE_S)
            return Goal(there, velocity), OnPath(time_s, where.anchor)
    begin = path(where.time_s)
    if farthest(begin, state.position) <= ARRIVED_RAD:
        return resting(begin), OnPath(where.time_s, (step.capture_ns, where.time_s))
    return resting(begin), where.left()
