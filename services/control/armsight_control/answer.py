"""What one instant's positions are answered with: the command at once, what tells of it when it is asked for."""

from dataclasses import dataclass
from functools import cached_property

from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from armsight.times import to_duration, to_timestamp
from armsight.v1.control_pb2 import (
    CONTROL_MODE_FOLLOW,
    CONTROL_MODE_TRACK,
    CONTROL_STATE_BLIND,
    CONTROL_STATE_WAITING,
    ControlMode,
    ControlStatus,
    JointEstimate,
)
from armsight.v1.joints_pb2 import JointCommand, JointPositions, StageTimes
from armsight_control.chain import Array, Chain
from armsight_control.decision import Decision
from armsight_control.description import vector3
from armsight_control.estimators import Estimate
from armsight_control.kinematics import forward
from armsight_control.looking import Looking
from armsight_control.modes import AIMING
from armsight_control.movement import Pointed

# How long a command counts, in simulated time: MoveIt Servo's default.
VALID_FOR_S = 0.1
_VALID_FOR = to_duration(VALID_FOR_S)


@dataclass(frozen=True, slots=True)
class Aimed:
    """What the modes with a target were about; base frame, metres."""

    clearance_m: float | None
    correction: Array
    target: Array | None
    pointed: Pointed | None


@dataclass(frozen=True)
class Answer:
    """The answer to one instant.

    The arm waits for the command, and nothing for the rest: that is made once the command is sent.
    """

    capture_ns: int
    command: JointCommand
    stages: StageTimes
    mode: ControlMode
    decision: Decision
    chain: Chain | None
    looking: Looking | None
    """What tells the angles, once anything was looked at."""
    aimed: Aimed
    again: bool = False
    """The same answer was given before."""

    @property
    def estimate(self) -> Estimate | None:
        """The angles, as far as they are known."""
        return None if self.looking is None else self.looking.estimate

    @cached_property
    def estimated(self) -> JointStates:
        """The angles."""
        estimated = JointStates(timestamp=to_timestamp(self.capture_ns))
        estimate = self.estimate
        if self.chain is None or estimate is None:
            return estimated
        for name, angle in zip(self.chain.names, estimate.angles.tolist(), strict=True):
            estimated.joints.append(JointState(name=name, position=angle))
        if estimate.velocity is not None:
            for state, velocity in zip(estimated.joints, estimate.velocity.tolist(), strict=True):
                state.velocity = velocity
        return estimated

    @cached_property
    def status(self) -> ControlStatus:
        """How it came about."""
        decision = self.decision
        status = ControlStatus(
            capture_time=to_timestamp(self.capture_ns),
            mode=self.mode,
            state=decision.state,
            detail=decision.detail,
            stages=self.stages,
            safety=decision.safety,
        )
        if self.chain is not None:
            if (estimate := self.estimate) is not None:
                _fill_estimate(status, self.chain, estimate)
            _fill_target(status, self.aimed)
        return status


def command_of(message: JointPositions, decision: Decision, names: tuple[str, ...]) -> JointCommand:
    """What the arm is told for a decision about the positions of one instant."""
    command = JointCommand(
        answers=message.capture_time,
        valid_for=_VALID_FOR,
        hold=decision.setpoint is None,
        stages=message.stages,
    )
    if decision.setpoint is not None:
        for name, angle in zip(names, decision.setpoint.tolist(), strict=True):
            command.joints.add(name=name, position_rad=angle)
    return command


def _fill_estimate(status: ControlStatus, chain: Chain, estimate: Estimate) -> None:
    seen_now = status.state not in (CONTROL_STATE_BLIND, CONTROL_STATE_WAITING)
    status.estimator = estimate.estimator
    for name, angle, observable in zip(chain.names, estimate.angles, estimate.observable, strict=True):
        status.joints.append(JointEstimate(name=name, position_rad=angle, observable=observable and seen_now))
    if estimate.sigma is not None and estimate.velocity is not None:
        for joint, sigma, velocity in zip(status.joints, estimate.sigma, estimate.velocity, strict=True):
            joint.sigma_rad, joint.velocity_rad_s = sigma, velocity
    status.tip.CopyFrom(vector3(forward(chain, estimate.angles)))


def _fill_target(status: ControlStatus, aimed: Aimed) -> None:
    if aimed.clearance_m is not None:
        status.clearance_m = aimed.clearance_m
    if status.mode not in AIMING:
        return
    status.correction.CopyFrom(vector3(aimed.correction))
    if aimed.target is not None and status.mode == CONTROL_MODE_TRACK:
        status.target.CopyFrom(vector3(aimed.target))
    if aimed.pointed is not None:
        if status.mode == CONTROL_MODE_FOLLOW:
            status.target.CopyFrom(vector3(aimed.pointed.target))
        status.reached.CopyFrom(vector3(aimed.pointed.reached))
        status.target_reachable = aimed.pointed.reachable
