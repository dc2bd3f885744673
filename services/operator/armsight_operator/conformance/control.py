"""Checks of a control: sim and vision are played by forward kinematics, in lockstep, where no answer is late."""

import time

import numpy as np
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from armsight import topics
from armsight.bus import Bus
from armsight.errors import NoReplyError, RefusedError
from armsight.times import from_timestamp, to_timestamp, wall_ns
from armsight.v1.control_pb2 import (
    CONTROL_MODE_HOLD,
    CONTROL_MODE_JOINTS,
    CONTROL_MODE_UNSPECIFIED,
    CONTROL_STATE_STOPPED,
    CONTROL_STATE_UNSPECIFIED,
    IK_STATUS_CONVERGED,
    IK_STATUS_UNREACHABLE,
    SAFETY_CODE_IMPLAUSIBLE,
    SAFETY_CODE_LOST,
    ControlMode,
    ControlState,
    ControlStatus,
    ForwardKinematicsRequest,
    IkStatus,
    SafetyCode,
    SetModeRequest,
    SolveIkRequest,
    SolveIkResponse,
)
from armsight.v1.geometry_pb2 import Vector3
from armsight.v1.health_pb2 import Health
from armsight.v1.joints_pb2 import JointCommand, JointPositions, JointSetpoint
from armsight.v1.safety_pb2 import StopSource, StopState
from armsight.v1.sim_pb2 import CLOCK_MODE_LOCKSTEP, Clock
from armsight_operator.conformance import judge, scene
from armsight_operator.conformance.check import Check, UnfulfilledError, require
from armsight_operator.conformance.scene import PERIOD_NS, Array, Scene
from armsight_operator.conformance.station import (
    ANSWER_S,
    DIRT,
    Station,
    drained,
    of_every_service,
    of_instant,
    refused,
)

_SETTLE_S = 0.3
"""What is latched, a stop or a setpoint, has arrived after so long: 9 frames."""

_DESCRIBED_S = 5.0
"""The description has been taken after so long."""

_QUIET_S = 0.3
_TAKEN_S = 0.05
"""A ring keeps one message: the next may come once that has been taken."""

_ARRIVE_FRAMES = 300
_LOST_FRAMES = 90
"""Three seconds: what is not seen may be predicted for a while."""

_ARRIVED_RAD = 0.01
_STRAY_RAD = 0.05
MAX_STEP = scene.MAX_SPEED_RAD_S * PERIOD_NS / 1e9
_SOLVER_S = 60.0
"""A solver may have to be loaded, and refuses until it is."""

_START = np.array([0.3, 0.2, -0.4, 0.5])
_GOAL = np.array([0.6, 0.0, -0.2, 0.2])


class Loop:
    """Sim and vision beside the control that is judged: an arm that follows every command at once."""

    def __init__(self, bus: Bus) -> None:
        """Describes the arm."""
        self.station = Station(bus, "control", ("sim", "vision"))
        self._bus = bus
        self.scene = Scene(scene.description())
        self.q: Array = np.zeros(len(self.scene.names))
        self._capture_ns = wall_ns()
        self._description = bus.publisher(topics.DESCRIPTION)
        self._accepted = bus.publisher(topics.JOINTS_ACCEPTED)
        self._positions = bus.publisher(topics.JOINT_POSITIONS)
        self._clock = bus.publisher(topics.CLOCK)
        self._stop = bus.publisher(topics.STOP_STATE)
        self._targets = bus.publisher(topics.TARGET)
        self._commands = bus.subscriber(topics.JOINT_COMMAND, keep=1000)
        self._statuses = bus.subscriber(topics.CONTROL_STATUS, keep=1000)
        self._estimates = bus.subscriber(topics.JOINTS_ESTIMATED, keep=1000)
        self._stop.put(StopState())
        self._description.put(self.scene.described)

    def close(self) -> None:
        """Takes sim and vision away."""
        self.station.close()

    def settle(self) -> None:
        """Waits until the description has arrived: before that a control may refuse anything."""
        request = SetModeRequest(mode=CONTROL_MODE_JOINTS, joints=self._setpoints(self.q))
        until = time.monotonic() + _DESCRIBED_S
        while time.monotonic() < until:
            try:
                self._bus.query(topics.MODE, request, timeout_s=1.0)
            except (NoReplyError, RefusedError):
                time.sleep(0.05)
            else:
                return

    # --- what the suite does

    def reset(self, q: Array) -> None:
        """The arm is at rest at a pose, and sim says so."""
        self.q = np.array(q)
        self._capture_ns += 30 * PERIOD_NS
        self._accepted.put(self.scene.states(self.q, self._capture_ns))
        # a second after the last instant: who heard of it only with the positions might take them for a far future's
        self._clock.put(Clock(capture_time=to_timestamp(self._capture_ns), mode=CLOCK_MODE_LOCKSTEP))
        time.sleep(_SETTLE_S)

    def mode(self, mode: ControlMode, goal: Array | None = None) -> None:
        """Sets a mode."""
        joints = [] if goal is None else self._setpoints(goal)
        try:
            answer = self._bus.query(topics.MODE, SetModeRequest(mode=mode, joints=joints), timeout_s=ANSWER_S)
        except (NoReplyError, RefusedError) as error:
            raise UnfulfilledError(f"{ControlMode.Name(mode)}: {error}", "that control/mode takes it") from error
        require(answer.mode == mode, f"mode {answer.mode} in the answer", ControlMode.Name(mode))

    def frame(self, lost: tuple[str, ...] = ()) -> JointCommand:
        """One instant: positions out, the answer judged, and obeyed."""
        self._capture_ns += PERIOD_NS
        return self.show(self.scene.positions(self.q, self._capture_ns, lost))

    def show(self, positions: JointPositions) -> JointCommand:
        """Puts positions, and obeys the answer."""
        capture_ns = from_timestamp(positions.capture_time)
        self._clock.put(Clock(capture_time=positions.capture_time, mode=CLOCK_MODE_LOCKSTEP))
        self._positions.put(positions)
        return self.obey(self._answer(capture_ns))

    def obey(self, command: JointCommand) -> JointCommand:
        """Judges a command, and moves the arm as it says."""
        step = np.full(len(self.q), MAX_STEP)
        q = judge.check_command(command, self.scene.names, self.scene.arm.limits, self.q, step)
        if q is not None:
            self.q = q
            self._accepted.put(self.scene.states(q, from_timestamp(command.answers)))
        return command

    def status(self, capture_ns: int) -> ControlStatus:
        """The status of an instant."""
        found = of_instant(self._statuses, capture_ns, ANSWER_S)
        if found is None:
            raise UnfulfilledError("no control/status for an instant that was answered", "one for each answer")
        return found

    def _estimated(self) -> Array:
        found = of_instant(self._estimates, self._capture_ns, ANSWER_S)
        if found is None:
            raise UnfulfilledError("no joints/estimated for an instant that was answered", "one for each answer")
        return _angles(found, self.scene.names)

    def _answer(self, capture_ns: int) -> JointCommand:
        found = of_instant(self._commands, capture_ns, ANSWER_S)
        if found is None:
            raise UnfulfilledError(
                f"no joints/command for positions within {ANSWER_S:g} s", "an answer, if only a hold"
            )
        return found

    def _setpoints(self, q: Array) -> list[JointSetpoint]:
        return [JointSetpoint(name=name, position_rad=angle) for name, angle in zip(self.scene.names, q, strict=True)]

    def _moving(self) -> None:
        """The arm is on its way to a goal that is far."""
        self.reset(_START)
        self.mode(CONTROL_MODE_JOINTS, np.array([-1.5, 0.0, 1.0, -1.0]))
        for _ in range(30):
            if not self.frame().hold:
                return
        raise UnfulfilledError("30 holds on the way to a goal", "motion in the mode joints")

    # --- checks

    def waits(self) -> None:
        """Nothing moves before the setpoint in force is known."""
        # joints of other names: whatever it has heard before in its life does not say where these are
        other = Scene(scene.description("conformance_"))
        self._description.put(other.described)
        try:
            time.sleep(_SETTLE_S)
            goal = [JointSetpoint(name=name, position_rad=0.5) for name in other.names]
            request = SetModeRequest(mode=CONTROL_MODE_JOINTS, joints=goal)
            try:
                self._bus.query(topics.MODE, request, timeout_s=ANSWER_S)
            except RefusedError:
                pass  # it may well say that it can't yet
            except NoReplyError as error:
                raise UnfulfilledError(str(error), "an answer on control/mode") from error
            for _ in range(5):
                self._capture_ns += PERIOD_NS
                positions = other.positions(self.q, self._capture_ns)
                self._clock.put(Clock(capture_time=positions.capture_time, mode=CLOCK_MODE_LOCKSTEP))
                self._positions.put(positions)
                command = self._answer(self._capture_ns)
                require(command.hold, "motion before joints/accepted was heard", "hold until sim has told the setpoint")
        finally:
            self._description.put(self.scene.described)
            time.sleep(_SETTLE_S)
            self.reset(self.q)
            self.mode(CONTROL_MODE_HOLD)

    def answers(self) -> None:
        """Each positions message gets one command of its capture time."""
        self._moving()
        self._commands.clear()
        asked, answered = [], []
        for _ in range(30):
            asked.append(self._capture_ns + PERIOD_NS)
            answered.append(from_timestamp(self.frame().answers))
        answered += [from_timestamp(command.answers) for command in drained(self._commands, _QUIET_S)]
        judge.check_answers(asked, answered)

    def repeated(self) -> None:
        """The same positions again get the same answer."""
        self._moving()
        positions = self.scene.positions(self.q, self._capture_ns + PERIOD_NS)
        self._capture_ns += PERIOD_NS
        first = self.show(positions)
        self._positions.put(positions)
        again = self._answer(self._capture_ns)
        same = again.hold == first.hold and list(again.joints) == list(first.joints)
        require(same, "another answer to the same positions", "the same answer, and nothing that moves on")

    def arrives(self) -> None:
        """Mode joints brings the arm where it is told."""
        self.reset(_START)
        self.mode(CONTROL_MODE_JOINTS, _GOAL)
        self._go_to(_GOAL)

    def holds(self) -> None:
        """Mode hold moves nothing."""
        self.reset(_START)
        self.mode(CONTROL_MODE_HOLD)
        for _ in range(20):
            self.frame()
            judge.check_near("in mode hold the arm is at", self.q, _START, 1e-3, "rad")

    def never_the_twin(self) -> None:
        """Of the two poses that look the same, the one that sim accepted is the true one."""
        start = np.array([0.4, 0.2, 0.5, 0.6])
        for q in (start, scene.twin(start)):
            self.reset(q)
            goal = q + np.array([0.1, 0.0, 0.1, -0.1])
            self.mode(CONTROL_MODE_JOINTS, goal)
            self._go_to(goal, stray=(np.minimum(q, goal) - _STRAY_RAD, np.maximum(q, goal) + _STRAY_RAD))
            shown = self.q
            self.frame()
            judge.check_near("estimated", self._estimated(), shown, _STRAY_RAD, "rad")

    def obeys_stop(self) -> None:
        """A stop means hold, until it is released."""
        self._moving()
        self._stop.put(StopState(stopped=True, sources=[StopSource(name="conformance", stopped=True)]))
        try:
            time.sleep(_SETTLE_S)
            for _ in range(3):
                require(self.frame().hold, "a command that moves while safety/stop says stopped", "hold")
            state = self.status(self._capture_ns).state
            require(state == CONTROL_STATE_STOPPED, f"state {ControlState.Name(state)}", "CONTROL_STATE_STOPPED")
        finally:
            self._stop.put(StopState())
        time.sleep(_SETTLE_S)
        self._must_move_again("the stop was released")

    def lost_markers(self) -> None:
        """Where no marker is seen nothing moves for long."""
        self._moving()
        before = self.station.health()
        lost = tuple(self.scene.arm.markers)
        for _ in range(_LOST_FRAMES):
            if self.frame(lost).hold:
                break
        else:
            raise UnfulfilledError(f"it moved for {_LOST_FRAMES} frames without a marker", "hold")
        require(self.frame(lost).hold, "motion again with every marker lost", "hold")
        self._must_tell(SAFETY_CODE_LOST, before)
        self._must_move_again("all markers were seen again")

    def implausible(self) -> None:
        """Positions that can't be this arm's move nothing."""
        self._moving()
        before = self.station.health()
        self._capture_ns += PERIOD_NS
        positions = self.scene.positions(self.q, self._capture_ns)
        for marker in positions.markers:
            if marker.name == "red":
                marker.position.z += 4.0
        require(self.show(positions).hold, "motion though two markers of one link were 4 m too far apart", "hold")
        self._must_tell(SAFETY_CODE_IMPLAUSIBLE, before)
        self._must_move_again("positions were plausible again")

    def not_finite(self) -> None:
        """Positions that are no numbers move nothing."""
        self._moving()
        self._capture_ns += PERIOD_NS
        positions = self.scene.positions(self.q, self._capture_ns)
        for marker in positions.markers:
            marker.position.x = float("nan")
        require(self.show(positions).hold, "motion by positions that are no numbers", "hold")
        self._must_move_again("positions were numbers again")

    def stale(self) -> None:
        """Positions older than what was answered move nothing."""
        self._moving()
        before = self.station.health()
        self._commands.clear()
        old_ns = self._capture_ns - 10 * PERIOD_NS - 1
        for positions in (*(self.scene.positions(self.q, old_ns + k) for k in range(3)), JointPositions()):
            self._positions.put(positions)
            time.sleep(_TAKEN_S)
        for command in drained(self._commands, _QUIET_S):
            require(command.hold, "motion that answers an older instant than the last", "hold, or no answer")
        self.station.must_count(before, 3, "positions older than the last", ("refused", "stale"))
        self._must_move_again("positions were new again")

    def malformed(self) -> None:
        """Bytes that are no message are counted, and harm nothing."""
        self._moving()
        before = self.station.health()
        publishers = (self._description, self._accepted, self._positions, self._clock, self._stop, self._targets)
        for publisher in publishers:
            for dirt in DIRT[1:]:  # no bytes at all are a message whose fields are not set
                publisher.put_bytes(dirt)
        time.sleep(_TAKEN_S)
        # what is latched is for who comes later: not this
        self._description.put(self.scene.described)
        self._accepted.put(self.scene.states(self.q, self._capture_ns))
        self._stop.put(StopState())
        for key in (topics.MODE.key, topics.SOLVE_IK.key, topics.FORWARD_KINEMATICS.key):
            self.station.malformed_query(key)
        self.station.must_count(before, len(publishers), "malformed messages on the keys that it reads")
        self._must_move_again("malformed bytes came")

    def tells_status(self) -> None:
        """Each answer has a status."""
        self._moving()
        self._statuses.clear()
        for _ in range(5):
            command = self.frame()
            status = self.status(self._capture_ns)
            require(status.mode == CONTROL_MODE_JOINTS, f"mode {status.mode}", "CONTROL_MODE_JOINTS")
            require(status.state != CONTROL_STATE_UNSPECIFIED, "no state", "why the arm is commanded, or is not")
            judge.check_names("joints", [joint.name for joint in status.joints], self.scene.names)
            stages = ("frames_sent", "vision_received", "vision_sent", "control_received", "control_sent")
            judge.check_stages(status.stages, *stages)
            judge.check_stages(command.stages, *stages)

    def modes(self) -> None:
        """control/mode tells and sets, and refuses with a text."""
        self.mode(CONTROL_MODE_JOINTS, self.q)
        told = self._bus.query(topics.MODE, SetModeRequest(), timeout_s=ANSWER_S).mode
        require(told == CONTROL_MODE_JOINTS, f"mode {told} in force", "the mode that was set")
        unknown = SetModeRequest.FromString(b"\x08\x63")
        for what, request in (
            ("mode 99", unknown),
            ("joints without joints", SetModeRequest(mode=CONTROL_MODE_JOINTS)),
        ):
            with refused(f"{what} on control/mode"):
                self._bus.query(topics.MODE, request, timeout_s=ANSWER_S)
        kept = self._bus.query(topics.MODE, SetModeRequest(), timeout_s=ANSWER_S).mode
        require(kept == CONTROL_MODE_JOINTS, f"mode {kept} after a refusal", "the mode before")
        require(kept != CONTROL_MODE_UNSPECIFIED, "no mode", "the mode in force")
        self.mode(CONTROL_MODE_HOLD)

    def forward_kinematics(self) -> None:
        """The tip and its Jacobian by the description."""
        for q in (_START, _GOAL, np.array([2.0, -0.7, 1.1, -0.9])):
            request = ForwardKinematicsRequest(joints=self._setpoints(q))
            try:
                answer = self._bus.query(topics.FORWARD_KINEMATICS, request, timeout_s=ANSWER_S)
            except (NoReplyError, RefusedError) as error:
                raise UnfulfilledError(str(error), "an answer on control/forward_kinematics") from error
            judge.check_near("tip", _array(answer.tip), self.scene.arm.tip_at(q), 1e-6, "m")
            wanted = self.scene.jacobian(q).ravel()
            require(len(answer.jacobian) == len(wanted), f"{len(answer.jacobian)} numbers", "3 x joints, row by row")
            judge.check_near("Jacobian", np.array(answer.jacobian), wanted, 1e-4, "m/rad")
        with refused("a question without joints on control/forward_kinematics"):
            self._bus.query(topics.FORWARD_KINEMATICS, ForwardKinematicsRequest(), timeout_s=ANSWER_S)

    def solve_ik(self) -> None:
        """Inverse kinematics: within limits, with what is left."""
        q = np.array([0.5, 0.0, 0.6, -0.7])
        target = self.scene.arm.tip_at(q)
        solved = self._solved(SolveIkRequest(target=_vector(target)))
        status = IkStatus.Name(solved.status)
        require(solved.status == IK_STATUS_CONVERGED, f"{status} for a point within reach", "IK_STATUS_CONVERGED")
        self._check_solution(solved, target, 0.02)
        far = np.array([9.0, 0.0, 4.0])
        unsolved = self._solved(SolveIkRequest(target=_vector(far)))
        status = IkStatus.Name(unsolved.status)
        named = unsolved.status == IK_STATUS_UNREACHABLE
        require(named, f"{status} for a point 3 m out of reach", "IK_STATUS_UNREACHABLE")
        self._check_solution(unsolved, far, 20.0)
        nowhere = SolveIkRequest(target=Vector3(x=float("nan")))
        for what, request in (("a target that is no number", nowhere), ("no target", SolveIkRequest())):
            with refused(f"{what} on control/solve_ik"):
                self._bus.query(topics.SOLVE_IK, request, timeout_s=ANSWER_S)

    # --- what checks have in common

    def _go_to(self, goal: Array, stray: tuple[Array, Array] | None = None) -> None:
        for _ in range(_ARRIVE_FRAMES):
            self.frame()
            if stray is not None:
                inside = bool(((self.q >= stray[0]) & (self.q <= stray[1])).all())
                where = ", ".join(f"{angle:.2f}" for angle in self.q)
                require(inside, f"on the way to a goal nearby the arm was at ({where})", "the way of the accepted pose")
            if np.abs(self.q - goal).max() < _ARRIVED_RAD:
                return
        judge.check_near(f"after {_ARRIVE_FRAMES} frames the arm is at", self.q, goal, _ARRIVED_RAD, "rad")

    def _must_tell(self, code: SafetyCode, before: Health) -> None:
        name = SafetyCode.Name(code)
        told = self.status(self._capture_ns).safety
        require(told == code, f"{SafetyCode.Name(told)} in control/status", name)
        self.station.must_count(before, 1, name, (f"safety_{name.removeprefix('SAFETY_CODE_').lower()}",))

    def _must_move_again(self, after: str) -> None:
        for _ in range(_LOST_FRAMES):
            if not self.frame().hold:
                return
        raise UnfulfilledError(f"{_LOST_FRAMES} holds after {after}", "that the motion goes on")

    def _solved(self, request: SolveIkRequest) -> SolveIkResponse:
        until = time.monotonic() + _SOLVER_S
        while True:
            try:
                return self._bus.query(topics.SOLVE_IK, request, timeout_s=10.0)
            except NoReplyError as error:
                raise UnfulfilledError(str(error), "an answer on control/solve_ik") from error
            except RefusedError as refused:
                if not any(word in str(refused) for word in ("loading", "busy")) or time.monotonic() > until:
                    raise UnfulfilledError(f"refused: {refused}", "a solution") from refused
            time.sleep(0.2)

    def _check_solution(self, solved: SolveIkResponse, target: Array, within_m: float) -> None:
        given = {joint.name: joint.position_rad for joint in solved.joints}
        judge.check_names("joints of the solution", given, self.scene.names)
        q = np.array([given[name] for name in self.scene.names])
        limits = self.scene.arm.limits
        inside = bool(((q >= limits[:, 0] - 1e-6) & (q <= limits[:, 1] + 1e-6)).all())
        require(inside, "a solution outside of the limits", "angles within the limits")
        tip = self.scene.arm.tip_at(q)
        judge.check_near("tip of the solution", _array(solved.tip), tip, 1e-3, "m")
        off_m = float(np.linalg.norm(tip - target))
        seen = f"residual_m of {solved.residual_m:.4f}, while the tip is {off_m:.4f} m from the target"
        require(abs(solved.residual_m - off_m) < 1e-3, seen, "that distance")
        require(off_m <= within_m, f"the tip {off_m:.3f} m from the target", f"at most {within_m:g} m")


def _angles(states: JointStates, names: tuple[str, ...]) -> Array:
    given = {joint.name: joint.position for joint in states.joints}
    judge.check_names("joints/estimated has", given, names)
    return np.array([given[name] for name in names])


def _array(vector: Vector3) -> Array:
    return np.array([vector.x, vector.y, vector.z])


def _vector(values: Array) -> Vector3:
    return Vector3(x=values[0], y=values[1], z=values[2])


_COMMAND, _STATUS = "messages.md#jointcommand", "messages.md#controlstatus"
_SAFETY = "messages.md#safetycode"

CHECKS: tuple[Check[Loop], ...] = (
    *of_every_service("Control"),
    Check(
        "modes",
        "control/mode takes and tells the mode, and refuses an unknown one with a text.",
        "messages.md#setmoderequest",
        Loop.modes,
    ),
    Check(
        "waits-for-setpoint",
        "Nothing moves before joints/accepted has told the setpoint in force.",
        "own-part.md#control",
        Loop.waits,
    ),
    Check(
        "answers",
        "Every joints/positions is answered by one joints/command of its capture time.",
        _COMMAND,
        Loop.answers,
    ),
    Check(
        "repeated",
        "The same positions again get the same answer again.",
        "own-part.md#control",
        Loop.repeated,
    ),
    Check(
        "mode-joints",
        "Mode joints brings every joint to its goal, in commands that are complete, finite, within limits and speed.",
        "messages.md#controlmode",
        Loop.arrives,
    ),
    Check("mode-hold", "Mode hold moves nothing.", "messages.md#controlmode", Loop.holds),
    Check(
        "never-the-twin",
        "Of the two poses that look the same, the arm is in the one of joints/accepted.",
        "own-part.md#control",
        Loop.never_the_twin,
    ),
    Check("stop", "While safety/stop says stopped, every answer is a hold.", "messages.md#stopstate", Loop.obeys_stop),
    Check(
        "lost-markers",
        "Lost markers are no measurement: without any, answers are holds and counted.",
        "messages.md#markerstatus",
        Loop.lost_markers,
    ),
    Check(
        "implausible",
        "Positions that can't be those of this arm are answered with hold and counted.",
        _SAFETY,
        Loop.implausible,
    ),
    Check("not-finite", "Positions that are no numbers are answered with hold.", _SAFETY, Loop.not_finite),
    Check(
        "stale",
        "Positions that are older than what was answered move nothing and are counted.",
        _COMMAND,
        Loop.stale,
    ),
    Check(
        "malformed",
        "Bytes that are no message are counted, refused where they are a question, and harm nothing.",
        "own-part.md#every-part",
        Loop.malformed,
    ),
    Check("status", "control/status tells of each answer, with its stages in order.", _STATUS, Loop.tells_status),
    Check(
        "forward-kinematics",
        "control/forward_kinematics gives the tip and its Jacobian by the description, and refuses with a text.",
        "messages.md#forwardkinematicsrequest",
        Loop.forward_kinematics,
    ),
    Check(
        "solve-ik",
        "control/solve_ik gives angles within limits and how far they leave the tip, and refuses with a text.",
        "messages.md#solveikrequest",
        Loop.solve_ik,
    ),
)
