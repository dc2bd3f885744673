"""The setpoint in force: follows commands within speed and acceleration, and comes to rest without them.

Speed and acceleration are limited for all joints together (one scale for the whole vector), so that the arm keeps the
direction that was asked for. Where a joint would else pass its limit, its own braking comes before the direction.
"""

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
        self._lower, self._upper = limits.T
        self._max_speed = max_speed
        self._period = command_period_s
        self.reset(pose)

    def reset(self, pose: Vector) -> None:
        """At rest at a pose."""
        self.position: Vector = pose.copy()
        self.speed: Vector = np.zeros_like(pose)
        self._goal: Vector = pose.copy()
        self._cruise: float = 0.0
        self._braking = False

    @property
    def at_rest(self) -> bool:
        """Neither moving nor about to."""
        return not self.speed.any() and bool((self.position == self._goal).all())

    @property
    def braking(self) -> bool:
        """Coming to rest, or at rest, until the next command."""
        return self._braking

    @property
    def accepted(self) -> Vector:
        """The last command, or how far towards it the speed limit and braking have let the setpoint come."""
        in_one_period = np.abs(self._goal - self.position) <= self._max_speed * self._period
        return self._goal if not self._braking and in_one_period.all() else self.position

    def command(self, goal: Vector) -> None:
        """Sets where to go."""
        self._goal = goal.copy()
        self._braking = False
        # constant speed between two commands that come in time: no stuttering from frame to frame
        self._cruise = float(np.abs(goal - self.position).max()) / self._period

    def brake(self) -> None:
        """Decelerates as fast as allowed, and holds where that ends."""
        self._braking = True

    def step(self, dt: float) -> None:
        """Moves the setpoint by ``dt`` seconds."""
        wanted = np.zeros_like(self.speed) if self._braking else self._wanted_speed(dt)
        change = wanted - self.speed
        largest = float(np.abs(change).max())
        if largest > MAX_ACCELERATION_RAD_S2 * dt:
            change *= MAX_ACCELERATION_RAD_S2 * dt / largest
        self.speed = self._within_limits(self.speed + change, dt)
        self.position = np.clip(self.position + self.speed * dt, self._lower, self._upper)
        if self._braking and not self.speed.any():
            self._goal = self.position.copy()
        elif not self._braking and float(np.abs(self._goal - self.position).max()) < 1e-9:
            self.position, self.speed = self._goal.copy(), np.zeros_like(self.speed)

    def _wanted_speed(self, dt: float) -> Vector:
        away = self._goal - self.position
        distance = float(np.abs(away).max())
        if distance == 0.0:
            return np.zeros_like(away)
        direction = away / distance
        fastest = float((self._max_speed / np.maximum(np.abs(direction), 1e-12)).min())
        return np.asarray(direction * min(fastest, self._cruise, float(_stoppable(np.asarray(distance), dt))))

    def _within_limits(self, speed: Vector, dt: float) -> Vector:
        room = np.where(speed > 0.0, self._upper - self.position, self.position - self._lower)
        fastest = _stoppable(room, dt)
        return np.asarray(np.clip(speed, -fastest, fastest))


def _stoppable(room: Vector, dt: float) -> Vector:
    # largest v with v dt + v^2 / 2a <= room: what is left after one more step is enough to come to rest
    a = MAX_ACCELERATION_RAD_S2
    return np.asarray(a * (np.sqrt(dt * dt + 2.0 * room / a) - dt))
