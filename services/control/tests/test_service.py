"""armsight-control as a process on a private bus, with a sim and a vision made of forward kinematics."""

import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Point3InFrame_pb2 import Point3InFrame

from armsight.bus import Bus
from armsight.errors import NoReplyError, RefusedError
from armsight.session import SessionConfig, open_session
from armsight.times import from_timestamp, to_timestamp
from armsight.topics import (
    ASK_PARAMETERS,
    CLOCK,
    CONTROL_STATUS,
    DESCRIPTION,
    FORWARD_KINEMATICS,
    HEALTH,
    JOINT_COMMAND,
    JOINT_POSITIONS,
    JOINTS_ACCEPTED,
    JOINTS_ESTIMATED,
    MODE,
    SET_PARAMETERS,
    SOLVE_IK,
    STOP_STATE,
    TARGET,
)
from armsight.v1.control_pb2 import (
    CONTROL_MODE_HOLD,
    CONTROL_MODE_JOINTS,
    CONTROL_MODE_TEST_2,
    CONTROL_MODE_TRACK,
    CONTROL_STATE_BLIND,
    CONTROL_STATE_HOLDING,
    CONTROL_STATE_MOVING,
    CONTROL_STATE_STOPPED,
    CONTROL_STATE_WAITING,
    IK_STATUS_CONVERGED,
    IK_STATUS_UNREACHABLE,
    SAFETY_CODE_OK,
    ControlMode,
    ControlStatus,
    ForwardKinematicsRequest,
    SetModeRequest,
    SolveIkRequest,
    SolveIkResponse,
)
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.geometry_pb2 import Vector3
from armsight.v1.health_pb2 import HEALTH_STATUS_OK, HEALTH_STATUS_WAITING
from armsight.v1.joints_pb2 import MARKER_STATUS_LOST, JointCommand, JointSetpoint, MarkerStatus
from armsight.v1.parameters_pb2 import ParameterValue, SetParametersRequest
from armsight.v1.safety_pb2 import StopSource, StopState
from armsight.v1.sim_pb2 import CLOCK_MODE_LOCKSTEP, CLOCK_MODE_REALTIME, Clock, ClockMode
from armsight_control.chain import Array
from armsight_control.description import Arm
from armsight_control.kinematics import forward, jacobian
from armsight_control.trajectory import part2_motion

if TYPE_CHECKING:
    from tests.conftest import Camera

PERIOD_NS = 33_333_333
EXECUTABLE = Path(sys.executable).with_name("armsight-control")


class Rig:
    """A bus with a router, and what stands for sim and vision."""

    def __init__(
        self,
        endpoint: str,
        bus: Bus,
        description: ArmDescription,
        arm: Arm,
        camera: "Camera",
        states: Callable[..., JointStates],
    ) -> None:
        self.endpoint, self.bus, self.arm, self.camera, self.states = endpoint, bus, arm, camera, states
        self.q: Array = np.zeros(4)
        self.capture_ns = time.time_ns()
        # positions have no age in lockstep: a busy machine changes no answer
        self.clock_mode: ClockMode = CLOCK_MODE_LOCKSTEP
        self.command: JointCommand | None = None
        self.description = bus.publisher(DESCRIPTION)
        self.accepted = bus.publisher(JOINTS_ACCEPTED)
        self.positions = bus.publisher(JOINT_POSITIONS)
        self.targets = bus.publisher(TARGET)
        self.clock = bus.publisher(CLOCK)
        self.stops = bus.publisher(STOP_STATE)
        self.commands = bus.subscriber(JOINT_COMMAND, keep=16)
        self.statuses = bus.subscriber(CONTROL_STATUS, keep=16)
        self.estimates = bus.subscriber(JOINTS_ESTIMATED, keep=16)
        self.health = bus.subscriber(HEALTH, "control")
        self.process: subprocess.Popen[bytes] | None = None
        self.description.put(description)

    def start(self, *flags: str) -> None:
        # torch takes seconds of both cores to load, and answers that waited for them are stale: only where it is needed
        light = ["--solver", "closed-form"]
        self.process = subprocess.Popen([EXECUTABLE, "--connect", self.endpoint, *light, *flags])
        self.until(lambda: self.asked(SetModeRequest()) is not None, 30)

    def asked(self, request: SetModeRequest) -> ControlMode | None:
        try:
            return self.bus.query(MODE, request, timeout_s=0.5).mode
        except NoReplyError:
            return None

    def kill(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait()

    def until(self, condition: Callable[[], bool], timeout_s: float) -> None:
        deadline = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline, "waited in vain"
            time.sleep(0.02)

    def reset(self, q: Array) -> None:
        self.q = np.asarray(q, dtype=np.float64)
        self.accepted.put(self.states(self.q, self.capture_ns))
        time.sleep(0.1)

    def mode(self, mode: ControlMode, goal: Array | None = None, start_s: float = 0.0) -> None:
        joints = [] if goal is None else self.setpoints(goal)
        self.bus.query(MODE, SetModeRequest(mode=mode, joints=joints, start_s=start_s))

    def setpoints(self, q: Array) -> list[JointSetpoint]:
        return [
            JointSetpoint(name=name, position_rad=angle) for name, angle in zip(self.arm.chain.names, q, strict=True)
        ]

    def instant(self, status: dict[str, MarkerStatus] | None = None, timeout_s: float = 5.0) -> ControlStatus:
        """One instant: positions out, the answer in and applied."""
        self.capture_ns += PERIOD_NS
        return self.ask_again(status, timeout_s)

    def ask_again(self, status: dict[str, MarkerStatus] | None = None, timeout_s: float = 5.0) -> ControlStatus:
        self.clock.put(Clock(capture_time=to_timestamp(self.capture_ns), mode=self.clock_mode))
        self.positions.put(self.camera.positions(self.q, self.capture_ns, status))
        answered = None
        while answered is None or from_timestamp(answered.answers) != self.capture_ns:
            received = self.commands.recv(timeout_s)
            assert received is not None, "no answer"
            answered = received.message
        self.command = answered
        if not answered.hold:
            before, self.q = self.q, np.array([joint.position_rad for joint in answered.joints])
            assert np.abs(self.q - before).max() <= 5 / 30 + 1e-9
            self.accepted.put(self.states(self.q, self.capture_ns))
        return self.status_of(self.capture_ns, timeout_s)

    def status_of(self, capture_ns: int, timeout_s: float = 5.0) -> ControlStatus:
        while True:
            got = self.statuses.recv(timeout_s)
            assert got is not None, "no status"
            if from_timestamp(got.message.capture_time) == capture_ns:
                return got.message


@pytest.fixture
def rig(description: ArmDescription, arm: Arm, camera: "Camera", states: Callable[..., JointStates]) -> Iterator[Rig]:
    endpoint = f"tcp/127.0.0.1:{random.SystemRandom().randint(17000, 19999)}"
    stop = threading.Event()
    router = open_session(SessionConfig(mode="router", endpoints=(endpoint,), namespace="", shared_memory="off"), stop)
    session = open_session(SessionConfig(endpoints=(endpoint,), shared_memory="off"), stop)
    assert router is not None
    assert session is not None
    with router, session:
        rig = Rig(endpoint, Bus(session), description, arm, camera, states)
        yield rig
        rig.kill()


def test_a_commanded_configuration_is_reached_and_every_answer_is_published(rig: Rig) -> None:
    rig.start()
    rig.reset(np.zeros(4))
    goal = np.array([0.8, 0.3, -0.6, 0.5])
    rig.mode(CONTROL_MODE_JOINTS, goal)
    states = [rig.instant().state for _ in range(60)]
    np.testing.assert_allclose(rig.q, goal, atol=1e-9)
    assert states[0] == CONTROL_STATE_MOVING
    assert states[-1] == CONTROL_STATE_HOLDING
    assert rig.command is not None
    assert rig.command.stages.control_received_ns <= rig.command.stages.control_sent_ns
    estimated = rig.estimates.latest
    assert estimated is not None
    assert [joint.name for joint in estimated.message.joints] == list(rig.arm.chain.names)


def test_track_reaches_a_target_by_the_reports_descent_beside_the_loop(rig: Rig) -> None:
    rig.clock_mode = CLOCK_MODE_REALTIME
    rig.start("--mode", "track", "--solver", "gradient-descent")
    rig.reset(np.zeros(4))
    target = np.array([3.6, 1.0, 7.5])
    message = Point3InFrame(frame_id="base")
    message.point.x, message.point.y, message.point.z = target
    rig.targets.put(message)
    deadline = time.monotonic() + 90
    while np.abs(forward(rig.arm.chain, rig.q) - target).mean() > 0.006:
        assert time.monotonic() < deadline, "the tip did not arrive"
        began = time.monotonic()
        rig.instant()
        assert time.monotonic() - began < 1.0, "an answer waited for the solver"
        time.sleep(0.01)
    rig.until(lambda: rig.health.latest is not None and rig.health.latest.message.gauges["ik_ms"] > 0, 3)


def test_lockstep_waits_for_the_solution_and_two_runs_are_the_same(rig: Rig) -> None:
    runs = []
    for _ in range(2):
        rig.start("--mode", "hold", "--seed", "3", "--solver", "gradient-descent")
        rig.reset(np.array([0.2, 0.0, -0.4, 0.5]))
        rig.until(lambda: solves(rig), 60)
        rig.mode(CONTROL_MODE_TRACK)
        time.sleep(0.2)
        path = []
        for k in range(25):
            message = Point3InFrame(frame_id="base", timestamp=to_timestamp(rig.capture_ns + PERIOD_NS))
            message.point.x, message.point.y, message.point.z = 3.6 + 0.02 * k, 1.0, 7.5
            rig.targets.put(message)
            status = rig.instant(timeout_s=10)
            assert rig.command is not None
            assert not rig.command.hold, f"instant {k}: {status.detail}"
            path.append(rig.q)
        rig.kill()
        runs.append(np.array(path))
    assert np.ptp(runs[0], axis=0).max() > 0.1, "it moved"
    np.testing.assert_array_equal(runs[0], runs[1])


def test_in_lockstep_positions_that_waited_are_not_stale(rig: Rig) -> None:
    rig.start("--mode", "track", "--solver", "gradient-descent")
    rig.clock.put(Clock(capture_time=to_timestamp(rig.capture_ns), mode=CLOCK_MODE_LOCKSTEP))
    rig.reset(np.zeros(4))
    target = Point3InFrame(frame_id="base")
    target.point.x, target.point.y, target.point.z = 3.6, 1.0, 7.5
    rig.targets.put(target)
    # the first waits for torch to be loaded, and the second for the first
    for _ in range(2):
        rig.capture_ns += PERIOD_NS
        rig.positions.put(rig.camera.positions(rig.q, rig.capture_ns))
    second = rig.status_of(rig.capture_ns, timeout_s=20)
    assert second.stages.control_sent_ns - second.stages.control_received_ns > 0.1e9
    assert second.safety == SAFETY_CODE_OK, second.detail


def solves(rig: Rig) -> bool:
    try:
        rig.bus.query(SOLVE_IK, SolveIkRequest(target=Vector3(x=3.6, y=1.2, z=7.5)), timeout_s=6.0)
    except (RefusedError, NoReplyError):
        return False
    return True


def test_silence_of_vision_is_blind_and_motion_goes_on_afterwards(rig: Rig) -> None:
    rig.start()
    rig.reset(part2_motion(5.0))
    rig.mode(CONTROL_MODE_TEST_2, start_s=5.0)
    for _ in range(10):
        assert rig.instant().state == CONTROL_STATE_MOVING
    rig.statuses.clear()
    quiet = rig.statuses.recv(2.0)
    assert quiet is not None
    assert quiet.message.state == CONTROL_STATE_BLIND
    assert "is vision running?" in quiet.message.detail
    rig.capture_ns += 60 * PERIOD_NS
    before = rig.q
    assert rig.instant().state == CONTROL_STATE_MOVING
    assert np.abs(rig.q - before).max() < 0.02


def test_by_its_parts_a_lost_marker_is_answered_with_hold(rig: Rig) -> None:
    rig.start("--estimator", "parts")
    rig.reset(part2_motion(5.0))
    rig.mode(CONTROL_MODE_TEST_2, start_s=5.0)
    rig.instant()
    status = rig.instant({"red": MARKER_STATUS_LOST})
    assert status.state == CONTROL_STATE_BLIND
    assert rig.command is not None
    assert rig.command.hold
    assert rig.instant().state == CONTROL_STATE_MOVING


def test_one_lost_marker_breaks_no_motion_and_two_for_longer_are_answered_with_hold(rig: Rig) -> None:
    rig.start()
    rig.reset(part2_motion(5.0))
    rig.mode(CONTROL_MODE_TEST_2, start_s=5.0)
    rig.instant()
    assert rig.instant({"red": MARKER_STATUS_LOST}).state == CONTROL_STATE_MOVING
    for _ in range(60):
        lost = rig.instant({"red": MARKER_STATUS_LOST, "blue": MARKER_STATUS_LOST})
        if lost.state == CONTROL_STATE_BLIND:
            break
    assert lost.state == CONTROL_STATE_BLIND, "two seconds on what was known before"
    assert "can't be seen by any camera" in lost.detail
    assert rig.command is not None
    assert rig.command.hold
    rig.until(lambda: rig.instant().state == CONTROL_STATE_MOVING, 3)


def test_the_same_instant_again_gets_the_same_answer_again(rig: Rig) -> None:
    rig.start()
    rig.reset(part2_motion(5.0))
    rig.mode(CONTROL_MODE_TEST_2, start_s=5.0)
    for _ in range(3):
        rig.instant()
    first = list(rig.command.joints) if rig.command is not None else []
    rig.ask_again()
    assert rig.command is not None
    assert list(rig.command.joints) == first


def test_killed_and_restarted_it_goes_on_from_the_accepted_setpoint_and_never_to_the_twin(rig: Rig) -> None:
    rig.start("--mode", "test-2")
    rig.reset(part2_motion(0.0))
    while rig.q[0] < 2.0:
        rig.instant()
    rig.kill()
    before = rig.q
    rig.start("--mode", "test-2")
    for _ in range(100):
        status = rig.instant()
        assert status.state in (CONTROL_STATE_MOVING, CONTROL_STATE_WAITING), status.detail
        assert np.abs(rig.q - before).max() <= 0.3 * 5 / 30 + 1e-9
        before = rig.q


def test_it_waits_for_the_accepted_setpoint_and_says_so(rig: Rig) -> None:
    rig.start("--mode", "test-2")
    status = rig.instant()
    assert status.state == CONTROL_STATE_WAITING
    assert "accepted setpoint" in status.detail
    rig.until(lambda: rig.health.latest is not None and "accepted setpoint" in rig.health.latest.message.detail, 3)
    assert rig.health.latest is not None
    assert rig.health.latest.message.status == HEALTH_STATUS_WAITING
    rig.reset(np.zeros(4))
    assert rig.instant().state == CONTROL_STATE_MOVING


def test_the_stop_is_obeyed(rig: Rig) -> None:
    rig.start()
    rig.reset(part2_motion(5.0))
    rig.mode(CONTROL_MODE_TEST_2, start_s=5.0)
    rig.instant()
    rig.stops.put(StopState(stopped=True, sources=[StopSource(name="page", stopped=True)]))
    time.sleep(0.2)
    assert rig.instant().state == CONTROL_STATE_STOPPED
    rig.stops.put(StopState(stopped=False))
    time.sleep(0.2)
    assert rig.instant().state == CONTROL_STATE_MOVING


def test_malformed_bytes_on_every_key_are_counted_and_harm_nothing(rig: Rig) -> None:
    rig.start()
    rig.reset(np.zeros(4))
    rig.mode(CONTROL_MODE_JOINTS, np.array([0.5, 0, 0.3, 0.3]))
    rig.instant()
    dirt = random.Random(1)
    for publisher in (rig.description, rig.accepted, rig.positions, rig.targets, rig.clock, rig.stops):
        for size in (0, 1, 7, 100, 5000):
            publisher.put_bytes(dirt.randbytes(size))
    for key in ("control/mode", "control/solve_ik", "control/forward_kinematics"):
        replies = rig.bus.session.get(key, payload=b"\xff\xff\xff", timeout=3.0)
        for reply in replies:
            assert reply.err is not None
            assert b"not a armsight.v1." in reply.err.payload.to_bytes()
    time.sleep(0.2)
    assert rig.process is not None
    assert rig.process.poll() is None
    assert rig.instant().state == CONTROL_STATE_MOVING
    rig.until(
        lambda: rig.health.latest is not None and rig.health.latest.message.counters["malformed_joint_positions"] > 0, 3
    )


def test_queries_answer_and_refuse_with_a_text(rig: Rig) -> None:
    rig.start()
    rig.reset(np.zeros(4))
    q = np.array([0.4, -0.3, 0.7, -0.9])
    answer = rig.bus.query(FORWARD_KINEMATICS, ForwardKinematicsRequest(joints=rig.setpoints(q)))
    np.testing.assert_allclose([answer.tip.x, answer.tip.y, answer.tip.z], forward(rig.arm.chain, q), atol=1e-12)
    np.testing.assert_allclose(np.reshape(answer.jacobian, (3, 4)), jacobian(rig.arm.chain, q), atol=1e-12)
    with pytest.raises(RefusedError, match="this arm needs joint1, joint2, joint3, joint4"):
        rig.bus.query(FORWARD_KINEMATICS, ForwardKinematicsRequest())

    target = Vector3(x=3.6, y=1.2, z=7.5)
    solved = rig.bus.query(SOLVE_IK, SolveIkRequest(target=target))
    assert solved.status == IK_STATUS_CONVERGED
    assert solved.residual_m < 1e-9
    assert rig.bus.query(SOLVE_IK, SolveIkRequest(target=Vector3(x=9))).status == IK_STATUS_UNREACHABLE
    for text, request in (
        (
            "no solver 'newton'; there are torch, gradient-descent, levenberg-marquardt, closed-form",
            SolveIkRequest(target=target, solver="newton"),
        ),
        ("no target", SolveIkRequest()),
        ("not finite", SolveIkRequest(target=Vector3(x=float("nan")))),
        ("this arm needs", SolveIkRequest(target=target, start=[JointSetpoint(name="joint1")])),
        ("both given", SolveIkRequest(target=target, targets=[target])),
        (r"targets\[1\]: .*not finite", SolveIkRequest(targets=[target, Vector3(x=float("inf"))])),
        ("no joint 'elbow'; this arm has joint1", SolveIkRequest(target=target, free=["elbow"])),
        ("1001 targets: closed-form takes at most 1000", SolveIkRequest(targets=[target] * 1001)),
        ("takes at most 16", SolveIkRequest(targets=[target] * 17, solver="gradient-descent")),
    ):
        with pytest.raises(RefusedError, match=text):
            rig.bus.query(SOLVE_IK, request)

    below = Vector3(x=4.6, y=0.1, z=2.6)
    assert rig.bus.query(SOLVE_IK, SolveIkRequest(target=below)).status == IK_STATUS_UNREACHABLE
    freed = rig.bus.query(SOLVE_IK, SolveIkRequest(target=below, free=rig.arm.chain.names))
    assert freed.status == IK_STATUS_CONVERGED

    assert rig.asked(SetModeRequest()) == CONTROL_MODE_HOLD
    with pytest.raises(RefusedError, match="there are hold, joints, test-1, test-2, test-all, track, follow"):
        rig.bus.query(MODE, SetModeRequest.FromString(b"\x08\x63"))
    assert '"solver": "closed-form"' in rig.bus.query(ASK_PARAMETERS, ASK_PARAMETERS.request(), "control").json
    with pytest.raises(RefusedError, match=r"speed is a number within 0.01 to 0.3, not 0.4"):
        rig.bus.query(SET_PARAMETERS, SetParametersRequest(values={"speed": ParameterValue(number=0.4)}), "control")
    slower = SetParametersRequest(
        values={"solver": ParameterValue(text="gradient-descent"), "speed": ParameterValue(number=0.1)}
    )
    rig.bus.query(SET_PARAMETERS, slower, "control")
    # the solver in force is the one that was set
    with pytest.raises(RefusedError, match="gradient-descent takes at most 16"):
        rig.bus.query(SOLVE_IK, SolveIkRequest(targets=[target] * 17))


def test_a_query_names_no_solver_that_control_was_not_started_with(rig: Rig, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("def solve(chain, target, start, free):\n    return start\n")
    (tmp_path / "other.py").write_text(f"open({str(tmp_path / 'imported')!r}, 'w')\n\ndef solve(*_): return 0\n")
    rig.start("--solver", f"{tmp_path / 'mine.py'}:solve")
    rig.reset(np.zeros(4))
    target = Vector3(x=3.0, y=2.0, z=7.0)
    for place in (f"{tmp_path / 'other.py'}:solve", "os:system"):
        with pytest.raises(RefusedError, match="is not what control was started with"):
            rig.bus.query(SOLVE_IK, SolveIkRequest(target=target, solver=place))
        with pytest.raises(RefusedError, match="solver"):
            rig.bus.query(
                SET_PARAMETERS, SetParametersRequest(values={"solver": ParameterValue(text=place)}), "control"
            )
    assert not (tmp_path / "imported").exists()
    start = rig.setpoints(np.array([0.1, 0.0, 0.2, 0.3]))
    assert list(solved_once_loaded(rig, SolveIkRequest(target=target, start=start)).joints) == start


def solved_once_loaded(rig: Rig, request: SolveIkRequest) -> SolveIkResponse:
    """Until the solver is there it refuses, and says why."""
    answers: list[SolveIkResponse] = []
    refusals: list[str] = []

    def answered() -> bool:
        try:
            answers.append(rig.bus.query(SOLVE_IK, request, timeout_s=10))
        except RefusedError as refused:
            refusals.append(str(refused))
        return bool(answers)

    rig.until(answered, 90)
    assert all("solver loading" in refusal or "busy" in refusal for refusal in refusals)
    return answers[0]


def test_many_targets_are_answered_in_their_order_in_one_reply(rig: Rig) -> None:
    rig.start("--solver", "torch")
    rig.reset(np.zeros(4))
    targets = [Vector3(x=3.6, y=1.2, z=7.5), Vector3(x=9.0, z=4.0), Vector3(x=-2.0, y=2.0, z=8.0)]
    answer = solved_once_loaded(rig, SolveIkRequest(targets=targets, free=rig.arm.chain.names))
    solutions = answer.solutions
    assert [each.status for each in solutions] == [IK_STATUS_CONVERGED, IK_STATUS_UNREACHABLE, IK_STATUS_CONVERGED]
    assert solutions[1].residual_m == pytest.approx(3.0, abs=1e-3)
    for target, solution in zip(targets, solutions, strict=True):
        tip = forward(rig.arm.chain, np.array([joint.position_rad for joint in solution.joints]))
        off = np.linalg.norm(tip - [target.x, target.y, target.z])
        assert off == pytest.approx(solution.residual_m, abs=1e-9)


def test_a_descent_by_query_is_the_reports_whatever_solver_is_in_force(rig: Rig) -> None:
    rig.start("--max-steps", "20000")
    rig.reset(np.zeros(4))
    request = SolveIkRequest(target=Vector3(x=3.6, y=1.2, z=7.5), solver="gradient-descent")
    answer = solved_once_loaded(rig, request)
    assert answer.status == IK_STATUS_CONVERGED
    assert 1e-6 < answer.residual_m < 0.015
    assert answer.iterations > 10


def test_health_has_rate_and_latency_and_it_ends_on_sigterm_at_once(rig: Rig) -> None:
    rig.start("--mode", "hold")
    rig.reset(np.zeros(4))
    deadline = time.monotonic() + 2.5
    while time.monotonic() < deadline:
        rig.instant()
        time.sleep(0.02)
    health = rig.health.latest
    assert health is not None
    assert health.message.status == HEALTH_STATUS_OK
    assert health.message.gauges["rate_hz"] > 10
    assert 0 < health.message.gauges["latency_p50_ms"] <= health.message.gauges["latency_p99_ms"]
    assert rig.process is not None
    began = time.monotonic()
    rig.process.send_signal(signal.SIGTERM)
    assert rig.process.wait(timeout=5) == 0
    assert time.monotonic() - began < 2.0


@pytest.mark.parametrize(
    ("flags", "text"),
    [
        (["--alpha", "0"], "alpha 0.0"),
        (["--speed", "2"], "speed 2.0"),
        (["--seed", "-1"], "seed -1"),
        (["--solver", "newton"], "there are torch, gradient-descent"),
        (["--connect", "nonsense"], "tcp/HOST:PORT"),
        (["--max-steps", "0"], "max_steps 0"),
        (["--mode", "joints"], "invalid choice: 'joints'"),
    ],
)
def test_a_bad_configuration_ends_with_code_2_and_a_clear_line(flags: list[str], text: str) -> None:
    ended = subprocess.run([EXECUTABLE, *flags], capture_output=True, text=True, timeout=20, env=os.environ)
    assert ended.returncode == 2
    assert text in ended.stderr
    assert "Traceback" not in ended.stderr
