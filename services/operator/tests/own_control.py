"""A control as somebody could bring one: it fulfils the contract, and is broken by overriding a method."""

import threading
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from armsight import topics
from armsight.bus import Bus, Received
from armsight.errors import ArmsightError
from armsight.parameters import Tunable
from armsight.service import HealthReporter, serve_parameters
from armsight.times import from_timestamp, to_duration, wall_ns
from armsight.v1.control_pb2 import (
    CONTROL_MODE_HOLD,
    CONTROL_MODE_JOINTS,
    CONTROL_STATE_BLIND,
    CONTROL_STATE_HOLDING,
    CONTROL_STATE_MOVING,
    CONTROL_STATE_STOPPED,
    CONTROL_STATE_WAITING,
    IK_STATUS_CONVERGED,
    IK_STATUS_UNREACHABLE,
    SAFETY_CODE_IMPLAUSIBLE,
    SAFETY_CODE_LOST,
    SAFETY_CODE_NOT_READY,
    SAFETY_CODE_OK,
    SAFETY_CODE_STOPPED,
    ControlState,
    ControlStatus,
    ForwardKinematicsRequest,
    ForwardKinematicsResponse,
    JointEstimate,
    SafetyCode,
    SetModeRequest,
    SetModeResponse,
    SolveIkRequest,
    SolveIkResponse,
)
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.geometry_pb2 import Vector3
from armsight.v1.health_pb2 import HEALTH_STATUS_OK
from armsight.v1.joints_pb2 import MARKER_STATUS_LOST, JointCommand, JointPositions, JointSetpoint
from armsight.v1.safety_pb2 import StopState
from armsight_operator.report.chain import Arm, arm_of

Array = npt.NDArray[np.float64]
Verdict = tuple[ControlState, SafetyCode]
STEP_RAD = 0.05


class OwnControl:
    """Believes the accepted setpoint, and looks at positions only to see whether they fit it."""

    service: ClassVar[str] = "control"

    def __init__(self, bus: Bus) -> None:
        self.bus, self.lock = bus, threading.RLock()
        self.arm: Arm | None = None
        self.q: Array | None = None
        self.mode, self.goal = CONTROL_MODE_HOLD, np.zeros(4)
        self.stopped, self.last_ns = False, 0
        self.last: JointCommand | None = None
        self.commands = bus.publisher(topics.JOINT_COMMAND)
        self.statuses = bus.publisher(topics.CONTROL_STATUS)
        self.estimates = bus.publisher(topics.JOINTS_ESTIMATED)
        self.declare_parameters()
        self.health: Any = self.new_health()
        for topic, take in (
            (topics.DESCRIPTION, self.describe),
            (topics.JOINTS_ACCEPTED, self.accept),
            (topics.STOP_STATE, self.take_stop),
            (topics.JOINT_POSITIONS, self.positions),
        ):
            bus.subscriber(topic, on_message=lambda got, take=take: self._locked(take, got))  # type: ignore[misc]
        bus.subscriber(topics.TARGET)
        bus.subscriber(topics.CLOCK)
        bus.serve(topics.MODE, self.set_mode)
        bus.serve(topics.FORWARD_KINEMATICS, self.forward_kinematics)
        bus.serve(topics.SOLVE_IK, self.solve_ik)

    def _locked(self, take: Any, got: Received[Any]) -> None:
        with self.lock:
            take(got.message)

    def new_health(self) -> Any:
        health = HealthReporter(self.service, self.bus)
        health.report(HEALTH_STATUS_OK)
        return health

    def declare_parameters(self) -> None:
        tunables = (Tunable("speed", "share of the speed", 0.3, "", 0.0, 1.0),)
        serve_parameters(self.service, self.bus, {"speed": 0.3}).declare(tunables, lambda _: None)

    # --- what it hears

    def describe(self, message: ArmDescription) -> None:
        arm = arm_of(message)
        if self.arm is None or arm.names != self.arm.names:
            self.q = None
        self.arm = arm

    def accept(self, message: JointStates) -> None:
        given = {joint.name: joint.position for joint in message.joints}
        if self.arm is not None and set(given) == set(self.arm.names):
            self.q = np.array([given[name] for name in self.arm.names])

    def take_stop(self, message: StopState) -> None:
        self.stopped = message.stopped

    def positions(self, message: JointPositions) -> None:
        received_ns, capture_ns = wall_ns(), from_timestamp(message.capture_time)
        if capture_ns == self.last_ns and self.last is not None:
            self.send(self.last)
            return
        if self.is_old(capture_ns):
            self.bus.counters.add("positions_refused_order")
            return
        self.last_ns = max(capture_ns, self.last_ns)
        state, safety = self.judged(message)
        command = self.command(state == CONTROL_STATE_MOVING)
        command.answers.CopyFrom(message.capture_time)
        command.valid_for.CopyFrom(to_duration(0.1))
        command.stages.CopyFrom(message.stages)
        command.stages.control_received_ns, command.stages.control_sent_ns = received_ns, wall_ns()
        if safety != SAFETY_CODE_OK:
            self.count(SafetyCode.Name(safety))
        self.last = command
        self.send(command)
        self.tell(ControlStatus(capture_time=message.capture_time, state=state, safety=safety, stages=command.stages))

    # --- what it makes of it

    def is_old(self, capture_ns: int) -> bool:
        return capture_ns < self.last_ns or capture_ns == 0

    def judged(self, message: JointPositions) -> Verdict:
        if self.arm is None or self.q is None:
            return CONTROL_STATE_WAITING, SAFETY_CODE_NOT_READY
        if self.stopped:
            return CONTROL_STATE_STOPPED, SAFETY_CODE_STOPPED
        seen = {m.name: m.position for m in message.markers if m.status != MARKER_STATUS_LOST}
        if not self.enough(seen):
            return CONTROL_STATE_BLIND, SAFETY_CODE_LOST
        if not self.plausible(seen):
            return CONTROL_STATE_BLIND, SAFETY_CODE_IMPLAUSIBLE
        moving = self.mode == CONTROL_MODE_JOINTS
        return (CONTROL_STATE_MOVING if moving else CONTROL_STATE_HOLDING), SAFETY_CODE_OK

    def enough(self, seen: dict[str, Vector3]) -> bool:
        return len(seen) > 0

    def plausible(self, seen: dict[str, Vector3]) -> bool:
        assert self.arm is not None
        assert self.q is not None
        for name, position in seen.items():
            expected = self.arm.to_world(self.arm.point(self.q, self.arm.markers[name]))
            if not np.linalg.norm(expected - (position.x, position.y, position.z)) < 1.0:
                return False
        return True

    def command(self, moving: bool) -> JointCommand:
        if not moving or self.arm is None or self.q is None:
            return JointCommand(hold=True)
        return self.setpoint(self.q + np.clip(self.goal - self.q, -STEP_RAD, STEP_RAD))

    def setpoint(self, q: Array) -> JointCommand:
        assert self.arm is not None
        joints = [JointSetpoint(name=name, position_rad=angle) for name, angle in zip(self.arm.names, q, strict=True)]
        return JointCommand(joints=joints)

    # --- what it says

    def send(self, command: JointCommand) -> None:
        self.commands.put(command)

    def count(self, code: str) -> None:
        self.bus.counters.add(f"safety_{code.removeprefix('SAFETY_CODE_').lower()}")

    def tell(self, status: ControlStatus) -> None:
        status.mode = self.mode
        if self.arm is not None and self.q is not None:
            pairs = list(zip(self.arm.names, self.q, strict=True))
            status.joints.extend(JointEstimate(name=name, position_rad=angle) for name, angle in pairs)
            states = [JointState(name=name, position=angle) for name, angle in pairs]
            self.estimates.put(JointStates(timestamp=status.capture_time, joints=states))
        self.statuses.put(status)

    # --- what it answers

    def set_mode(self, request: SetModeRequest) -> SetModeResponse:
        with self.lock:
            if request.mode not in (0, CONTROL_MODE_HOLD, CONTROL_MODE_JOINTS):
                raise ArmsightError("there are hold and joints")
            if request.mode == CONTROL_MODE_JOINTS:
                self.goal = self._angles(request.joints)
            self.mode = request.mode or self.mode
            return SetModeResponse(mode=self.mode)

    def forward_kinematics(self, request: ForwardKinematicsRequest) -> ForwardKinematicsResponse:
        assert self.arm is not None
        q = self._angles(request.joints)
        return ForwardKinematicsResponse(tip=_vector(self.arm.tip_at(q)), jacobian=self._jacobian(q).ravel())

    def solve_ik(self, request: SolveIkRequest) -> SolveIkResponse:
        target = np.array([request.target.x, request.target.y, request.target.z])
        if not request.HasField("target") or not np.isfinite(target).all():
            raise ArmsightError("the target must be three finite numbers")
        assert self.arm is not None
        q = np.array([0.2, 0.0, 0.4, -0.4])
        for _ in range(200):
            jacobian = self._jacobian(q)
            away = target - self.arm.tip_at(q)
            q = q + np.clip(jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 0.01 * np.eye(3), away), -0.2, 0.2)
            q = np.clip(q, self.arm.limits[:, 0], self.arm.limits[:, 1])
        tip = self.arm.tip_at(q)
        off = float(np.linalg.norm(tip - target))
        status = IK_STATUS_CONVERGED if off < 0.01 else IK_STATUS_UNREACHABLE
        joints = [JointSetpoint(name=name, position_rad=angle) for name, angle in zip(self.arm.names, q, strict=True)]
        return SolveIkResponse(status=status, joints=joints, tip=_vector(tip), residual_m=off)

    def _jacobian(self, q: Array) -> Array:
        assert self.arm is not None
        return np.stack([(self.arm.tip_at(q + d) - self.arm.tip_at(q - d)) / 2e-5 for d in 1e-5 * np.eye(len(q))], 1)

    def _angles(self, joints: Any) -> Array:
        given = {joint.name: joint.position_rad for joint in joints}
        if self.arm is None or set(given) != set(self.arm.names):
            raise ArmsightError("every joint of the arm is needed, and no other")
        return np.array([given[name] for name in self.arm.names])


def _vector(values: Array) -> Vector3:
    return Vector3(x=values[0], y=values[1], z=values[2])
