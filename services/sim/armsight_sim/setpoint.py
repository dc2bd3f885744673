"""The setpoint in force: follows commands within speed and acceleration, and comes to rest without them.

Speed and acceleration are limited for all joints together (one scale for the whole vector), so that the arm keeps the
direction that was asked for. Where a joint would else pass its limit, its own braking comes before the direction.
In plain numbers: sixteen times a frame, for a handful of joints, NumPy's calls would cost six times the physics.
"""

import math

import numpy as np
import numpy.typing as npt

Vector = npt.NDArray[np.float64]

# What 1000 N·m can brake with the arm stretched out sideways (35 kg·m²) leaves 28 rad/s²; keep some for the actuators.
MAX_ACCELERATION_RAD_S2 = 20.0


class Setpoint:
    """Position and speed of the setpoint (rad, rad/s), moved step by step of simulated time."""

    def __init__(self, pose: Vector, limits: Vector, max_speed: Vector, command_period_s: float) -> None:
        """At rest at a pose.

        Args:
            pose: where to be, within the limits.
            limits: lower and upper of each joint, rad (n x 2).
            max_speed: of each joint, rad/s.
            command_period_s: usual time between two commands: a setpoint is reached in this time where speed allows it.
        """
        self._lower, self._upper = (bound.tolist() for bound in limits.T)
        self._max_speed = max_speed.tolist()
        self._period = command_period_s
        self.reset(pose)

    def reset(self, pose: Vector) -> None:
        """At rest at a pose."""
        self._position: list[float] = pose.tolist()
        self._speed = [0.0] * len(self._position)
        self._goal = self._position
        self._cruise = 0.0
        self._braking = False

    @property
    def position(self) -> Vector:
        """Where it is, rad."""
        return np.array(self._position)

    @property
    def speed(self) -> Vector:
        """How fast it moves, rad/s."""
        return np.array(self._speed)

    @property
    def at_rest(self) -> bool:
        """Neither moving nor about to."""
        return not any(self._speed) and self._position == self._goal

    @property
    def braking(self) -> bool:
        """Coming to rest, or at rest, until the next command."""
        return self._braking

    @property
    def accepted(self) -> Vector:
        """The last command, or how far towards it the speed limit and braking have let the setpoint come."""
        in_one_period = all(
            abs(goal - at) <= fastest * self._period
            for goal, at, fastest in zip(self._goal, self._position, self._max_speed, strict=True)
        )
        return np.array(self._goal if not self._braking and in_one_period else self._position)

    def command(self, goal: Vector) -> None:
        """Sets where to go."""
        self._goal = goal.tolist()
        self._braking = False
        # constant speed between two commands that come in time: no stuttering from frame to frame
        self._cruise = max(map(abs, self._away())) / self._period

    def brake(self) -> None:
        """Decelerates as fast as allowed, and holds where that ends."""
        self._braking = True

    def step(self, dt: float) -> None:
        """Moves the setpoint by ``dt`` seconds."""
        wanted = [0.0] * len(self._speed) if self._braking else self._wanted_speed(dt)
        change = [to - now for to, now in zip(wanted, self._speed, strict=True)]
        largest, allowed = max(map(abs, change)), MAX_ACCELERATION_RAD_S2 * dt
        if largest > allowed:
            change = [each * (allowed / largest) for each in change]
        joints = zip(self._speed, change, self._position, self._lower, self._upper, strict=True)
        moved = [_moved(speed + more, at, lower, upper, dt) for speed, more, at, lower, upper in joints]
        self._position, self._speed = [at for at, _ in moved], [speed for _, speed in moved]
        if self._braking and not any(self._speed):
            self._goal = self._position
        elif not self._braking and max(map(abs, self._away())) < 1e-9:
            self._position, self._speed = self._goal, [0.0] * len(self._goal)

    def _away(self) -> list[float]:
        return [goal - at for goal, at in zip(self._goal, self._position, strict=True)]

    def _wanted_speed(self, dt: float) -> list[float]:
        away = self._away()
        distance = max(map(abs, away))
        if distance == 0.0:
            return away
        direction = [each / distance for each in away]
        fastest = min(speed / max(abs(along), 1e-12) for speed, along in zip(self._max_speed, direction, strict=True))
        speed = min(fastest, self._cruise, _stoppable(distance, dt))
        return [along * speed for along in direction]


def _moved(speed: float, at: float, lower: float, upper: float, dt: float) -> tuple[float, float]:
    """Where a joint is after ``dt``, and how fast it may be so near to its limits."""
    fastest = _stoppable(upper - at if speed > 0.0 else at - lower, dt)
    speed = min(max(speed, -fastest), fastest)
    return min(max(at + speed * dt, lower), upper), speed


def _stoppable(room: float, dt: float) -> float:
    # largest v with v dt + v^2 / 2a <= room: what is left after one more step is enough to come to rest
    a = MAX_ACCELERATION_RAD_S2
    return a * (math.sqrt(dt * dt + 2.0 * room / a) - dt)
