"""The loop without the bus: positions of one instant in, command, estimate and status out.

The same instant gets the same answer again without anything moving on. Everything that can be wrong with what arrives
ends in an answer that holds, with its reason counted.
"""

import math
from dataclasses import dataclass, replace
from functools import partial

from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Point3InFrame_pb2 import Point3InFrame

from armsight.counters import Counters
from armsight.times import NS_PER_S, from_timestamp
from armsight.v1.control_pb2 import (
    CONTROL_MODE_TEST_1,
    CONTROL_STATE_BLIND,
    CONTROL_STATE_STOPPED,
    CONTROL_STATE_WAITING,
    SAFETY_CODE_NOT_READY,
    SAFETY_CODE_OK,
    SAFETY_CODE_STOPPED,
    ControlMode,
    SafetyCode,
)
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.joints_pb2 import JointPositions
from armsight.v1.safety_pb2 import StopState
from armsight_control import safety
from armsight_control.answer import VALID_FOR_S, Aimed, Answer, command_of
from armsight_control.bodies import tip_by_markers
from armsight_control.chain import Array
from armsight_control.decision import Decision, blind_code
from armsight_control.description import Arm, arm_of
from armsight_control.errors import ControlError, PositionsError, SetpointError, SolverError
from armsight_control.estimators import Observer, all_joints, check_estimator, observer_of, part1, part2
from armsight_control.looking import Looking
from armsight_control.modes import Mode
from armsight_control.movement import MotionOptions, Movement
from armsight_control.positions import (
    DistanceBounds,
    Positions,
    TipLine,
    capture_of,
    positions_of,
    tip_line_of,
)
from armsight_control.setpoints import Setpoints, setpoint_of
from armsight_control.solvers import Options, Problem, Solution
from armsight_control.tracking import Target
from armsight_control.trajectory import MotionLimits, Step

# Since an answer that is not known: sim's 30 frames a second.
_PERIOD_S = 1 / 30
# The clock may be heard later than the positions of frames that were sent after it, never by so much.
_AHEAD_NS = NS_PER_S


@dataclass(frozen=True, slots=True)
class _Body:
    """The arm and what is derived from it once."""

    arm: Arm
    observer: Observer
    bounds: DistanceBounds
    tip_line: TipLine | None


class Loop:
    """State of the control loop; called by one thread at a time."""

    def __init__(
        self,
        limits: MotionLimits,
        motion: MotionOptions,
        options: Options,
        seed: int,
        counters: Counters,
        estimator: str = all_joints.NAME,
    ) -> None:
        """Knows neither arm nor setpoint yet, and holds."""
        self._estimator = check_estimator(estimator)
        self._limits = limits
        self._movement = Movement(limits, motion, options, seed, counters)
        self._counters = counters
        self._body: _Body | None = None
        self._unusable = "no description of the arm yet: is sim running?"
        self._description = b""
        self._refused: ArmDescription | None = None
        """The description of an arm that the estimator chosen is not for."""
        self._accepted: JointStates | None = None
        self._setpoints = Setpoints()
        self._stop: StopState | None = None
        self._looking: Looking | None = None
        self._target_message: Point3InFrame | None = None
        self._last: Answer | None = None

    # --- what arrives beside the positions

    @property
    def arm(self) -> Arm | None:
        """The arm, once described."""
        return None if self._body is None else self._body.arm

    @property
    def mode(self) -> ControlMode:
        """The mode in force."""
        return self._movement.mode

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
        self._description, self._body, self._refused, self._looking = serialised, None, None, None
        self._setpoints.forget()
        self._movement.rest()
        try:
            observer = observer_of(self._estimator, arm, self._counters)
            self._body = _Body(arm, observer, DistanceBounds(arm), tip_line_of(arm))
            self._movement.describe(arm, message)
        except ControlError as error:
            self._refused = message
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
        if self._setpoints.accept(q, from_timestamp(message.timestamp)):
            self._movement.rest()

    def stop(self, message: StopState) -> None:
        """Takes the stop's state."""
        self._stop = message

    def aim(self, message: Point3InFrame) -> None:
        """Takes a target."""
        self._target_message = message
        try:
            self._movement.aim(message)
        except SolverError:
            self._counters.add("target_refused")

    def set_mode(self, mode: Mode) -> None:
        """Takes a mode that was checked, from the next answer on."""
        self._movement.set_mode(mode)

    def tune(self, motion: MotionOptions, estimator: str) -> None:
        """Takes another way to go and another estimator, from the next answer on.

        Raises:
            ControlError: no estimator of that name, or none for this arm.
        """
        if estimator != self._estimator:
            body = self._body
            if body is not None:
                self._body = replace(body, observer=observer_of(estimator, body.arm, self._counters))
            self._estimator = check_estimator(estimator)
        self._movement.tune(motion)
        if self._body is None and self._refused is not None:
            refused, self._refused, self._description = self._refused, None, b""
            self.describe(refused)

    def begin_anew(self) -> None:
        """Sim is another one than before: its time may begin anywhere."""
        self._last = None
        self._movement.begin_anew()

    # --- inverse kinematics beside the loop

    @property
    def target(self) -> Target | None:
        """The newest target."""
        return self._movement.target

    def problem(self) -> tuple[Target, Problem] | None:
        """What `track` or `follow` wants solved now."""
        setpoint = self.setpoint
        return None if setpoint is None else self._movement.problem(setpoint)

    def solved(self, target: Target, solution: Solution) -> None:
        """Takes a solution for a target."""
        self._movement.solved(target, solution)

    def unsolved(self, why: str) -> None:
        """Takes why a solver has no solution for a target."""
        self._movement.unsolved(why)

    # --- the answer

    def answer(self, message: JointPositions, age_s: float, now_ns: int | None = None) -> Answer | None:
        """Answers the positions of one instant; nothing where they are not newer than the last ones answered.

        Args:
            message: as it came.
            age_s: since it was received, by this process' monotonic clock.
            now_ns: the arm's clock, as far as it was heard. Positions far ahead of it are of no instant that a camera
                has seen, and once answered would keep all later ones out.
        """
        try:
            capture_ns = capture_of(message)
        except PositionsError as error:
            self._counters.add(f"positions_refused_{error.reason}")
            return None
        if now_ns is not None and capture_ns > now_ns + _AHEAD_NS:
            self._counters.add("positions_refused_future")
            return None
        if self._last is not None and capture_ns <= self._last.capture_ns:
            same = capture_ns == self._last.capture_ns
            self._counters.add("positions_again" if same else "positions_refused_order")
            return replace(self._last, again=True) if same else None
        decision = self._decide(message, capture_ns, age_s)
        if decision.setpoint is None:
            self._movement.rest()
        else:
            self._setpoints.command(capture_ns, decision.setpoint)
        if decision.safety != SAFETY_CODE_OK:
            self._counters.add(SafetyCode.Name(decision.safety).lower().replace("_code", ""))
        self._counters.add("answered" if decision.setpoint is not None else f"held_{decision.reason or 'no_motion'}")
        self._last = self._answer(message, capture_ns, decision)
        return self._last

    def _decide(self, message: JointPositions, capture_ns: int, age_s: float) -> Decision:
        body = self._body
        if body is None:
            detail = self._unusable
            return Decision(CONTROL_STATE_WAITING, detail, reason="no_description", safety=SAFETY_CODE_NOT_READY)
        setpoint = self._setpoints.in_force(capture_ns)
        if setpoint is None:
            detail = "no accepted setpoint yet: start sim, or reset it to a known pose"
            return Decision(CONTROL_STATE_WAITING, detail, reason="no_setpoint", safety=SAFETY_CODE_NOT_READY)
        step = Step(capture_ns, self._since_s(capture_ns))
        try:
            positions = positions_of(message, body.arm)
            safety.check_age(age_s)
            body.bounds.check(positions)
            self._look(message, positions, body, setpoint, step)
        except PositionsError as error:
            code = blind_code(error.reason)
            return Decision(CONTROL_STATE_BLIND, str(error), reason=error.reason, safety=code)
        stopped = safety.stopped_by(self._stop)
        if stopped is not None:
            code = SAFETY_CODE_STOPPED
            return Decision(CONTROL_STATE_STOPPED, stopped.detail, reason=stopped.reason, safety=code)
        return self._movement.move(setpoint, step, self._setpoints.lead_s)

    def _since_s(self, capture_ns: int) -> float:
        """How long a step the answer to an instant is."""
        since_s = math.inf if self._last is None else (capture_ns - self._last.capture_ns) / NS_PER_S
        if since_s <= VALID_FOR_S:
            return since_s
        # the last command has lapsed: the arm stands, and goes on from there
        self._movement.rest()
        return _PERIOD_S

    def _look(self, message: JointPositions, positions: Positions, body: _Body, setpoint: Array, step: Step) -> None:
        """Takes what was seen, and refuses it where the arm must not move on it.

        Where the markers beside the tip show it, the command does not wait for the angles.
        """
        before = self._looking.estimate if self._looking is not None else None
        preferred = part1.NAME if self.mode == CONTROL_MODE_TEST_1 else part2.NAME
        looking = Looking(partial(body.observer.look, positions, setpoint, preferred), before, self._counters)
        tip = None if body.tip_line is None else tip_by_markers(positions, body.tip_line)
        try:
            at = tip.position if tip is not None and body.observer.needs_no_angles(tip) else looking.tip()
            safety.check_astray(body.arm.chain, setpoint, at, self._limits.speed_share)
            self._movement.look(message, tip, setpoint, step)
        except PositionsError:
            _ = looking.estimate  # the estimator follows the arm, wherever it is
            raise
        self._looking = looking

    def _answer(self, message: JointPositions, capture_ns: int, decision: Decision) -> Answer:
        movement, chain = self._movement, None if self._body is None else self._body.arm.chain
        target = None if movement.target is None else movement.target.position
        return Answer(
            capture_ns=capture_ns,
            command=command_of(message, decision, () if chain is None else chain.names),
            stages=message.stages,
            mode=self.mode,
            decision=decision,
            chain=chain,
            looking=self._looking,
            aimed=Aimed(movement.clearance_m, movement.correction, target, movement.pointed),
        )
