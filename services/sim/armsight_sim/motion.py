"""The arm in motion: commands through the gate, the setpoint, the watchdog, physics.

Everything runs on simulated time; nothing in here knows the bus.
"""

import numpy as np
import numpy.typing as npt

from armsight.times import NS_PER_S
from armsight.v1.joints_pb2 import JointCommand
from armsight_sim.clock import WATCHDOG_S, Instants
from armsight_sim.commands import CommandGate, Decision, Verdict
from armsight_sim.setpoint import Setpoint
from armsight_sim.world import World

Vector = npt.NDArray[np.float64]


class Motion:
    """Moves a world frame by frame, as commands allow."""

    def __init__(self, world: World, instants: Instants, pose: Vector, *, external_cameras: bool = False) -> None:
        """At rest at a pose, at the instant of frame 0.

        Args:
            world: the arm's.
            instants: of frames.
            pose: angles of all joints.
            external_cameras: see :class:`~armsight_sim.commands.CommandGate`.
        """
        self.world = world
        self._instants = instants
        self._gate = CommandGate(world, external_cameras=external_cameras)
        self._setpoint = Setpoint(pose, world.limits, world.max_speed, 1.0 / instants.fps)
        self._since_command_s = 0.0
        self._steps = 0
        self.frame = 0
        self.watchdog_trips = 0
        world.reset(pose)

    @property
    def capture_ns(self) -> int:
        """Instant of the last frame."""
        return self._instants.capture_ns(self.frame)

    @property
    def now_ns(self) -> int:
        """Simulated time now."""
        return self.capture_ns + round(self._steps * self.world.step_s * NS_PER_S)

    @property
    def accepted(self) -> Vector:
        """The setpoint in force: the last command as it is applied."""
        return self._setpoint.accepted

    def command(self, command: JointCommand, *, stopped: bool) -> Decision:
        """Takes or refuses one command."""
        decision = self._gate.decide(command, self.now_ns, self.capture_ns, stopped=stopped)
        if decision.verdict is Verdict.MOVE and decision.goal is not None:
            self._setpoint.command(decision.goal)
            self._since_command_s = 0.0
        return decision

    def halt(self) -> None:
        """Decelerates and holds: a stop."""
        self._setpoint.brake()

    def reset(self, pose: Vector) -> int:
        """Puts the arm at a pose, at rest; returns the first instant whose frames show it."""
        self.world.reset(pose)
        self._setpoint.reset(pose)
        first_ns = self._instants.capture_ns(self.frame + 1)
        self._gate.refuse_before(first_ns)
        return first_ns

    def advance(self, steps: int) -> None:
        """Physics up to so many steps after the last frame; never beyond the next one."""
        while self._steps < min(steps, self.world.steps_per_frame):
            self._step()

    def next_frame(self) -> None:
        """Physics up to the next frame's instant."""
        self.advance(self.world.steps_per_frame)
        self.frame += 1
        self._steps = 0

    def _step(self) -> None:
        self._since_command_s += self.world.step_s
        if self._since_command_s > WATCHDOG_S and not self._setpoint.at_rest and not self._setpoint.braking:
            self.watchdog_trips += 1
            self._setpoint.brake()
        self._setpoint.step(self.world.step_s)
        self.world.step(self._setpoint.position, self._setpoint.speed)
        self._steps += 1
