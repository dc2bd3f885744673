"""The loop without the bus: positions of one instant in, command, estimate and status out.

The same instant gets the same answer again without anything moving on. Everything that can be wrong with what arrives
ends in an answer that holds, with its reason counted.
"""

from dataclasses import dataclass

import numpy as np
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Point3InFrame_pb2 import Point3InFrame

from armsight.counters import Counters
from armsight.times import NS_PER_S, to_duration, to_timestamp
from armsight.v1.control_pb2 import (
    CONTROL_MODE_HOLD,
    CONTROL_MODE_JOINTS,
    CONTROL_MODE_TEST_1,
    CONTROL_MODE_TEST_2,
    CONTROL_MODE_TEST_ALL,
    CONTROL_MODE_TRACK,
    CONTROL_STATE_BLIND,
    CONTROL_STATE_HOLDING,
    CONTROL_STATE_MOVING,
    CONTROL_STATE_STOPPED,
    CONTROL_STATE_WAITING,
    ControlMode,
    ControlState,
    ControlStatus,
    JointEstimate,
)
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.geometry_pb2 import Vector3
from armsight.v1.joints_pb2 import JointCommand, JointPositions, JointSetpoint
from armsight.v1.safety_pb2 import StopState
from armsight_control import safety
from armsight_control.chain import Array
from armsight_control.description import Arm, arm_of
from armsight_control.errors import ControlError, PositionsError, SetpointError, SolverError
from armsight_control.estimators import Estimate, Observer, all_joints, check_estimator, part1, part2
from armsight_control.kinematics import forward, links_of
from armsight_control.modes import Mode
from armsight_control.positions import (
    DistanceBounds,
    capture_of,
    last_links_of,
    positions_of,
)
from armsight_control.setpoints import Setpoints, setpoint_of
from armsight_control.solvers import REPORT_FREE, Options, Problem, Solution, Status
from armsight_control.solvers.start import perturbed
from armsight_control.tracking import Target, target_of
from armsight_control.trajectory import (
    ARRIVED_RAD,
    Motion,
    MotionLimits,
    OnPath,
    Step,
    all_motion,
    along,
    part1_motion,
    part2_motion,
    towards,
)

# How long a command counts, in simulated time: MoveIt Servo's default.
VALID_FOR_S = 0.1
# Since an answer that is not known: sim's 30 frames a second.
_PERIOD_S = 1 / 30
# Descents that go on from one another for one target that does not move, before it is left at that.
_MOST_DESCENTS = 60

_PATHS = {CONTROL_MODE_TEST_1: part1_motion, CONTROL_MODE_TEST_2: part2_motion, CONTROL_MODE_TEST_ALL: all_motion}


@dataclass(frozen=True, slots=True)
class Answer:
    """What one instant's positions are answered with."""

    capture_ns: int
    command: JointCommand
    estimated: JointStates
    status: ControlStatus
    again: bool = False
    """The same answer was given before."""


@dataclass(frozen=True, slots=True)
class _Body:
    """The arm and what is derived from it once."""

    arm: Arm
    observer: Observer
    bounds: DistanceBounds


@dataclass(frozen=True, slots=True)
class _Decision:
    """Where to, or why not."""

    state: ControlState
    detail: str
    setpoint: Array | None = None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Solved:
    """The newest solution and what it is for."""

    target: Target
    solution: Solution


class Loop:
    """State of the control loop; called by one thread at a time."""

    def __init__(
        self,
        limits: MotionLimits,
        options: Options,
        seed: int,
        counters: Counters,
        estimator: str = all_joints.NAME,
    ) -> None:
        """Knows neither arm nor setpoint yet, and holds."""
        self._estimator = check_estimator(estimator)
        self._limits = limits
        self._options = options
        self._rng = np.random.default_rng(seed)
        self._counters = counters
        self._body: _Body | None = None
        self._unusable = "no description of the arm yet: is sim running?"
        self._description = b""
        self._accepted: JointStates | None = None
        self._setpoints = Setpoints()
        self._stop: StopState | None = None
        self._mode = Mode(CONTROL_MODE_HOLD)
        self._motion = Motion()
        self._path = OnPath(0.0)
        self._estimate: Estimate | None = None
        self._target_message: Point3InFrame | None = None
        self._target: Target | None = None
        self._solved: Solved | None = None
        self._descents = 0
        self._last: Answer | None = None

    # --- what arrives beside the positions

    @property
    def arm(self) -> Arm | None:
        """The arm, once described."""
        return None if self._body is None else self._body.arm

    @property
    def mode(self) -> ControlMode:
        """The mode in force."""
        return self._mode.mode

    @property
    def answered(self) -> bool:
        """Whether positions were answered, of the sim that is there now."""
        return self._last is not None

    @property
    def setpoint(self) -> Array | None:
        """The setpoint in force, once accepted."""
        return self._setpoints.in_force(self._last.capture_ns if self._last is not None else 0)

    def describe(self, message: ArmDescription) -> None:
        """Takes the arm as sim describes it.

        The same description again changes nothing, nor does one that describes no arm at all.
        """
        serialised = message.SerializeToString(deterministic=True)
        if serialised == self._description:
            return
        try:
            arm = arm_of(message)
        except ControlError as error:
            self._counters.add("description_refused")
            if self._body is None:
                self._unusable = f"the arm's description can't be used: {error}"
            return
        self._description, self._body = serialised, None
        self._setpoints.forget()
        self._rest()
        try:
            links_of(arm.chain)
            observer = Observer(self._estimator, arm, last_links_of(arm), self._counters)
            self._body = _Body(arm, observer, DistanceBounds(arm))
        except ControlError as error:
            self._counters.add("description_unsupported")
            self._unusable = f"this arm can't be controlled: {error}"
            return
        if self._accepted is not None:
            self.accept(self._accepted)
        if self._target_message is not None:
            self.aim(self._target_message)

    def accept(self, message: JointStates) -> None:
        """Takes the setpoint that sim says is in force."""
        self._accepted = message
        if self._body is None:
            return
        try:
            q = setpoint_of(message, self._body.arm.chain)
        except SetpointError:
            self._counters.add("accepted_refused")
            return
        if self._setpoints.accept(q):
            self._rest()

    def stop(self, message: StopState) -> None:
        """Takes the stop's state."""
        self._stop = message

    def aim(self, message: Point3InFrame) -> None:
        """Takes a target."""
        self._target_message = message
        if self._body is None:
            return
        try:
            self._target = target_of(message, self._body.arm)
        except SolverError:
            self._counters.add("target_refused")

    def set_mode(self, mode: Mode) -> None:
        """Takes a mode that was checked, from the next answer on."""
        self._mode = mode
        self._path = OnPath(mode.start_s)
        self._motion = Motion()
        self._solved, self._descents = None, 0

    def begin_anew(self) -> None:
        """Sim is another one than before: its time may begin anywhere."""
        self._last = None
        self._rest()

    # --- inverse kinematics beside the loop

    @property
    def target(self) -> Target | None:
        """The newest target."""
        return self._target

    def problem(self) -> tuple[Target, Problem] | None:
        """What `track` wants solved now: warm-started from the last solution, first of all from the setpoint."""
        setpoint = self.setpoint
        if self.mode != CONTROL_MODE_TRACK or self._body is None or self._target is None or setpoint is None:
            return None
        start, solved = setpoint, self._solved
        if solved is not None:
            start = solved.solution.q
            if np.array_equal(solved.target.position, self._target.position):
                if solved.solution.converged or self._descents >= _MOST_DESCENTS:
                    return None
            else:
                self._descents = 0
        chain = self._body.arm.chain
        if solved is None or not solved.solution.converged:
            # straight poses are saddles of the error: a descent that starts on one exactly stays there
            start = perturbed(chain, start, self._rng)
        return self._target, Problem(chain, self._target.position, start, REPORT_FREE, self._options)

    def solved(self, target: Target, solution: Solution) -> None:
        """Takes a solution for a target."""
        self._counters.add(f"ik_{solution.status.name.lower()}")
        self._descents += 1
        self._solved = Solved(target, solution)

    # --- the answer

    def answer(self, message: JointPositions, age_s: float) -> Answer | None:
        """Answers the positions of one instant; nothing where they are not newer than the last ones answered.

        Args:
            message: as it came.
            age_s: since it was received, by this process' monotonic clock.
        """
        try:
            capture_ns = capture_of(message)
        except PositionsError as error:
            self._counters.add(f"positions_refused_{error.reason}")
            return None
        if self._last is not None and capture_ns <= self._last.capture_ns:
            same = capture_ns == self._last.capture_ns
            self._counters.add("positions_again" if same else "positions_refused_order")
            return (
                Answer(capture_ns, self._last.command, self._last.estimated, self._last.status, True) if same else None
            )
        decision = self._decide(message, capture_ns, age_s)
        if decision.setpoint is None:
            self._rest()
        else:
            self._setpoints.command(capture_ns, decision.setpoint)
        self._counters.add("answered" if decision.setpoint is not None else f"held_{decision.reason or 'no_motion'}")
        self._last = self._answer(message, capture_ns, decision)
        return self._last

    def _rest(self) -> None:
        self._motion = Motion()
        self._path = self._path.left()

    def _decide(self, message: JointPositions, capture_ns: int, age_s: float) -> _Decision:
        body = self._body
        if body is None:
            return _Decision(CONTROL_STATE_WAITING, self._unusable, reason="no_description")
        setpoint = self._setpoints.in_force(capture_ns)
        if setpoint is None:
            detail = "no accepted setpoint yet: start sim, or reset it to a known pose"
            return _Decision(CONTROL_STATE_WAITING, detail, reason="no_setpoint")
        try:
            estimate = self._look(message, body, setpoint, age_s)
        except PositionsError as error:
            return _Decision(CONTROL_STATE_BLIND, str(error), reason=error.reason)
        self._estimate = estimate
        stopped = safety.stopped_by(self._stop)
        if stopped is not None:
            return _Decision(CONTROL_STATE_STOPPED, stopped.detail, reason=stopped.reason)
        since_s = _PERIOD_S if self._last is None else (capture_ns - self._last.capture_ns) / NS_PER_S
        return self._move(body, setpoint, Step(capture_ns, min(since_s, VALID_FOR_S)))

    def _look(self, message: JointPositions, body: _Body, setpoint: Array, age_s: float) -> Estimate:
        positions = positions_of(message, body.arm)
        safety.check_age(age_s)
        body.bounds.check(positions)
        preferred = part1.NAME if self.mode == CONTROL_MODE_TEST_1 else part2.NAME
        estimate, tip = body.observer.look(positions, setpoint, preferred)
        safety.check_astray(body.arm.chain, setpoint, tip, self._limits.speed_share)
        return estimate

    def _move(self, body: _Body, setpoint: Array, step: Step) -> _Decision:
        chain = body.arm.chain
        motion, path = self._motion, self._path
        goal = self._goal()
        if isinstance(goal, str):
            return _Decision(CONTROL_STATE_HOLDING, goal)
        if goal is None:
            following = _PATHS[self.mode]
            wanted, path, motion = along(chain, following, path, setpoint, step, motion, self._limits)
        elif np.abs(chain.clip(goal) - setpoint).max() <= ARRIVED_RAD:
            return _Decision(CONTROL_STATE_HOLDING, "at its goal")
        else:
            wanted, motion = towards(chain, setpoint, goal, step.dt_s, motion, self._limits)
        try:
            safety.check_setpoint(chain, setpoint, wanted, step.dt_s)
        except safety.UnsafeError as error:
            return _Decision(CONTROL_STATE_HOLDING, str(error), reason="unsafe")
        self._motion, self._path = motion, path
        return _Decision(CONTROL_STATE_MOVING, "", wanted)

    def _goal(self) -> Array | str | None:
        """Where to: a configuration, why there is none, or nothing where the mode follows a path."""
        if self.mode == CONTROL_MODE_JOINTS:
            return self._mode.goal
        if self.mode == CONTROL_MODE_TRACK:
            if self._target is None:
                return "no target yet: publish one on `target`"
            return "the solver has no answer yet" if self._solved is None else self._solved.solution.q
        return "mode hold" if self.mode == CONTROL_MODE_HOLD else None

    # --- messages

    def _answer(self, message: JointPositions, capture_ns: int, decision: _Decision) -> Answer:
        stamp = to_timestamp(capture_ns)
        command = JointCommand(
            answers=stamp,
            valid_for=to_duration(VALID_FOR_S),
            hold=decision.setpoint is None,
            stages=message.stages,
        )
        status = ControlStatus(
            capture_time=stamp,
            mode=self.mode,
            state=decision.state,
            detail=decision.detail,
            stages=message.stages,
        )
        estimated = JointStates(timestamp=stamp)
        if self._body is not None:
            names = self._body.arm.chain.names
            if decision.setpoint is not None:
                for name, angle in zip(names, decision.setpoint, strict=True):
                    command.joints.append(JointSetpoint(name=name, position_rad=angle))
            if self._estimate is not None:
                self._fill_estimate(status, estimated, names, self._estimate)
            self._fill_target(status)
        return Answer(capture_ns, command, estimated, status)

    def _fill_estimate(
        self, status: ControlStatus, estimated: JointStates, names: tuple[str, ...], estimate: Estimate
    ) -> None:
        seen_now = status.state not in (CONTROL_STATE_BLIND, CONTROL_STATE_WAITING)
        status.estimator = estimate.estimator
        for name, angle, observable in zip(names, estimate.angles, estimate.observable, strict=True):
            status.joints.append(JointEstimate(name=name, position_rad=angle, observable=observable and seen_now))
            estimated.joints.append(JointState(name=name, position=angle))
        if estimate.sigma is not None and estimate.velocity is not None:
            for joint, state, sigma, velocity in zip(
                status.joints, estimated.joints, estimate.sigma, estimate.velocity, strict=True
            ):
                joint.sigma_rad, joint.velocity_rad_s, state.velocity = sigma, velocity, velocity
        if self._body is not None:
            status.tip.CopyFrom(_vector(forward(self._body.arm.chain, estimate.angles)))

    def _fill_target(self, status: ControlStatus) -> None:
        if self.mode != CONTROL_MODE_TRACK or self._target is None:
            return
        status.target.CopyFrom(_vector(self._target.position))
        if self._solved is not None:
            status.reached.CopyFrom(_vector(self._solved.solution.tip))
            status.target_reachable = self._solved.solution.status != Status.UNREACHABLE


def _vector(values: Array) -> Vector3:
    return Vector3(x=values[0], y=values[1], z=values[2])
