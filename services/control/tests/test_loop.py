import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Point3InFrame_pb2 import Point3InFrame
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from armsight.counters import Counters
from armsight.times import NS_PER_S, from_duration, from_timestamp, to_timestamp
from armsight.v1.control_pb2 import (
    CONTROL_MODE_JOINTS,
    CONTROL_MODE_TEST_1,
    CONTROL_MODE_TRACK,
    CONTROL_STATE_BLIND,
    CONTROL_STATE_HOLDING,
    CONTROL_STATE_MOVING,
    CONTROL_STATE_STOPPED,
    CONTROL_STATE_WAITING,
    ControlMode,
    SetModeRequest,
)
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.joints_pb2 import (
    MARKER_STATUS_LOST,
    JointPositions,
    JointSetpoint,
    MarkerStatus,
)
from armsight.v1.safety_pb2 import StopSource, StopState
from armsight_control.answer import Answer
from armsight_control.bodies import Seen
from armsight_control.chain import Array
from armsight_control.description import Arm
from armsight_control.errors import ControlError, ModeError, PositionsError, SetpointError, UnsupportedArmError
from armsight_control.estimators import Estimate, Observer, observer_of
from armsight_control.kinematics import forward
from armsight_control.loop import Loop
from armsight_control.modes import NAMES, Mode, mode_of
from armsight_control.movement import MotionOptions
from armsight_control.positions import Positions
from armsight_control.solvers import Options, solve
from armsight_control.trajectory import MotionLimits, all_motion, part1_motion, part2_motion

if TYPE_CHECKING:
    from tests.conftest import Camera

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 33_333_333


class Stack:
    """A loop with an arm that is where it was last commanded to be: sim and vision without a bus."""

    def __init__(
        self, description: ArmDescription, arm: Arm, camera: "Camera", states: Callable[..., JointStates]
    ) -> None:
        self.arm, self.camera, self.states = arm, camera, states
        self.q: Array = np.zeros(4)
        self.capture_ns = START_NS
        self.counters = Counters()
        self.limits = MotionLimits()
        self.estimator = "all"
        self.velocity, self.dt_s, self.answered_ns = np.zeros(4), 0.0, START_NS
        self.loop = self.new_loop(description)
        self.description = description

    def new_loop(self, description: ArmDescription) -> Loop:
        loop = Loop(self.limits, MotionOptions(), Options(), 0, self.counters, self.estimator)
        loop.describe(description)
        return loop

    def reset(self, q: Array) -> None:
        self.q = np.asarray(q, dtype=np.float64)
        self.velocity, self.dt_s = np.zeros(4), 0.0
        self.loop.accept(self.states(self.q, self.capture_ns))

    def accept_wrong(self, q: Array) -> None:
        """Hears of a setpoint that is not in force; what sim says next is right again."""
        self.loop.accept(self.states(q))
        if (np.abs(q) <= self.arm.chain.limits[:, 1] + 1e-3).all():
            self.reset(self.q)
        else:  # no setpoint of this arm: refused, and the motion goes on
            self.loop.accept(self.states(self.q, self.capture_ns))

    def mode(self, name: str, goal: Array | None = None, start_s: float = 0.0) -> None:
        self.loop.set_mode(Mode(NAMES[name], goal, start_s))

    def look(self, status: dict[str, MarkerStatus] | None = None) -> JointPositions:
        return self.camera.positions(self.q, self.capture_ns, status)

    def step(
        self,
        message: JointPositions | None = None,
        age_s: float = 0.001,
        status: dict[str, MarkerStatus] | None = None,
    ) -> Answer:
        """One instant: look, answer, apply; checks what must hold for every command."""
        self.capture_ns += PERIOD_NS
        answer = self.loop.answer(self.look(status) if message is None else message, age_s)
        assert answer is not None
        self.apply(answer)
        return answer

    def apply(self, answer: Answer) -> None:
        command = answer.command
        assert from_timestamp(command.answers) == answer.capture_ns
        assert from_duration(command.valid_for) == pytest.approx(0.1)
        assert command.hold == (not command.joints)
        if not command.hold:
            assert [joint.name for joint in command.joints] == list(self.arm.chain.names)
            q = np.array([joint.position_rad for joint in command.joints])
            assert (q == self.arm.chain.clip(q)).all()
            dt_s = (answer.capture_ns - self.answered_ns) / 1e9
            if dt_s > 0.1:  # the last command has lapsed: it begins anew, from rest
                dt_s, self.velocity, self.dt_s = PERIOD_NS / 1e9, np.zeros(4), 0.0
            velocity = (q - self.q) / dt_s
            assert np.abs(velocity).max() <= 5 * self.limits.speed_share + 1e-6
            most = self.limits.acceleration_rad_s2 * (dt_s + self.dt_s) / 2
            assert np.abs(velocity - self.velocity).max() <= most + 1e-5
            self.q, self.velocity, self.dt_s = q, velocity, dt_s
            self.loop.accept(self.states(q, answer.capture_ns))
        else:
            self.velocity, self.dt_s = np.zeros(4), 0.0
        self.answered_ns = answer.capture_ns

    def estimate(self, answer: Answer) -> Array:
        return np.array([joint.position for joint in answer.estimated.joints])


@pytest.fixture
def stack(description: ArmDescription, arm: Arm, camera: "Camera", states: Callable[..., JointStates]) -> Stack:
    return Stack(description, arm, camera, states)


def test_without_a_description_and_without_a_setpoint_it_waits_and_says_for_what(stack: Stack) -> None:
    stack.loop = Loop(stack.limits, MotionOptions(), Options(), 0, stack.counters)
    answer = stack.step()
    assert (answer.status.state, answer.command.hold) == (CONTROL_STATE_WAITING, True)
    assert "description" in answer.status.detail
    stack.loop.describe(stack.description)
    stack.mode("joints", np.array([0.1, 0, 0, 0]))
    answer = stack.step()
    assert (answer.status.state, answer.command.hold) == (CONTROL_STATE_WAITING, True)
    assert "setpoint" in answer.status.detail
    stack.reset(np.zeros(4))
    assert stack.step().status.state == CONTROL_STATE_MOVING


def test_joints_reaches_the_configuration_and_then_holds(stack: Stack) -> None:
    goal = np.array([1.0, 0.4, -0.7, 0.6])
    stack.reset(np.zeros(4))
    stack.mode("joints", goal)
    states = [stack.step().status.state for _ in range(90)]
    np.testing.assert_allclose(stack.q, goal, atol=1e-9)
    assert states[0] == CONTROL_STATE_MOVING
    assert states[-1] == CONTROL_STATE_HOLDING


@pytest.mark.parametrize(
    ("name", "motion", "asked", "answering"),
    [
        ("test-1", part1_motion, "parts", "part1"),
        ("test-2", part2_motion, "parts", "part2"),
        ("test-2", part2_motion, "part2", "part2"),
        ("test-1", part1_motion, "all", "all"),
        ("test-2", part2_motion, "all", "all"),
        ("test-all", all_motion, "all", "all"),
    ],
)
def test_a_test_from_its_start_is_its_sinusoid_and_its_angles_are_found(
    name: str, motion: Callable[[float], Array], asked: str, answering: str, stack: Stack
) -> None:
    stack.estimator = asked
    stack.loop = stack.new_loop(stack.description)
    stack.reset(motion(8.0))
    stack.mode(name, start_s=8.0)
    for k in range(240):
        before = stack.q
        answer = stack.step()
        # it starts from rest: half a second to be on the path, to a fifth of a millimetre at the tip
        near = 3e-5 if k > 15 else 0.05
        np.testing.assert_allclose(stack.q, stack.arm.chain.clip(motion(8.0 + k * PERIOD_NS / 1e9)), atol=near)
        observable = [joint.observable for joint in answer.status.joints]
        assert np.abs(stack.estimate(answer) - before)[observable].max() < 1e-6
        assert answer.status.estimator == answering
        assert all((joint.sigma_rad > 0) == (answering == "all") for joint in answer.status.joints)


def test_the_same_instant_again_gets_the_same_answer_and_nothing_moves_on(stack: Stack) -> None:
    stack.reset(part2_motion(5.0))
    stack.mode("test-2", start_s=5.0)
    for _ in range(5):
        first = stack.step()
    again = stack.loop.answer(stack.look(), 0.001)
    assert again is not None
    assert again.again
    assert again.command == first.command
    assert again.estimated == first.estimated
    following = stack.step()
    goal = part2_motion(5.0 + 5 * PERIOD_NS / 1e9)
    np.testing.assert_allclose([joint.position_rad for joint in following.command.joints], goal, atol=0.03)


def test_positions_older_than_the_last_answered_ones_get_no_answer(stack: Stack) -> None:
    stack.reset(np.zeros(4))
    stack.step()
    old = stack.camera.positions(stack.q, stack.capture_ns - 1)
    assert stack.loop.answer(old, 0.0) is None
    assert stack.counters.snapshot()["positions_refused_order"] == 1


def test_another_arm_with_more_joints_is_taken_while_control_runs(stack: Stack) -> None:
    stack.reset(np.zeros(4))
    stack.step()
    other = ArmDescription()
    other.CopyFrom(stack.description)
    other.joints.add().CopyFrom(other.joints[3])
    other.joints[4].name = "joint5"
    stack.loop.describe(other)
    stack.capture_ns += PERIOD_NS
    answer = stack.loop.answer(stack.look(), 0.001)
    assert answer is not None
    assert answer.command.hold, "nothing is known of where its joints are"
    assert not answer.status.joints


def test_positions_of_an_instant_that_nobody_has_seen_keep_no_later_ones_out(stack: Stack) -> None:
    stack.reset(np.zeros(4))
    stack.step()
    ahead = stack.camera.positions(stack.q, stack.capture_ns + 2 * NS_PER_S)
    assert stack.loop.answer(ahead, 0.0, stack.capture_ns) is None
    assert stack.counters.snapshot()["positions_refused_future"] == 1
    assert stack.step().capture_ns == stack.capture_ns


def test_a_new_sim_may_begin_at_an_earlier_time(stack: Stack) -> None:
    stack.reset(np.zeros(4))
    stack.step()
    stack.loop.begin_anew()
    stack.capture_ns -= 3600 * 10**9
    assert stack.step().capture_ns < START_NS


@pytest.mark.parametrize("marker", ["red", "blue"])
def test_a_lost_marker_holds_and_motion_goes_on_from_the_setpoint_when_it_is_back(stack: Stack, marker: str) -> None:
    stack.estimator = "parts"
    stack.loop = stack.new_loop(stack.description)
    stack.reset(part1_motion(3.0))
    stack.mode("test-1", start_s=3.0)
    for _ in range(10):
        stack.step()
    before = stack.q
    for _ in range(30):
        stack.capture_ns += PERIOD_NS
        answer = stack.loop.answer(stack.look({marker: MARKER_STATUS_LOST}), 0.001)
        assert answer is not None
        assert (answer.status.state, answer.command.hold) == (CONTROL_STATE_BLIND, True)
        assert marker in answer.status.detail
        assert not any(joint.observable for joint in answer.status.joints)
    stack.step()
    assert np.abs(stack.q - before).max() < 0.02
    for _ in range(39):
        before = stack.q
        stack.step()
        assert np.abs(stack.q - before).max() < 0.03
    # the path waited: where it is now is where it would have been 30 instants ago, but for coming to rest and back
    expected = [part1_motion(3.0 + (48 + late) * PERIOD_NS / 1e9) for late in range(-10, 3)]
    assert min(np.abs(stack.q - q).max() for q in expected) < 0.01
    assert stack.counters.snapshot()["held_lost"] == 30


@pytest.mark.parametrize("marker", ["yellow", "red", "blue"])
def test_a_lost_marker_does_not_stop_an_arm_that_all_others_show(stack: Stack, marker: str) -> None:
    stack.reset(all_motion(9.0))
    stack.mode("test-all", start_s=9.0)
    for k in range(60):
        before = stack.q
        answer = stack.step(status={marker: MARKER_STATUS_LOST} if k >= 10 else None)
        assert answer.status.state == CONTROL_STATE_MOVING
        np.testing.assert_allclose(stack.estimate(answer), before, atol=2e-3)
    assert "held_lost" not in stack.counters.snapshot()


class Watched:
    """An estimator that notes when it is asked."""

    def __init__(self, observer: Observer) -> None:
        self.observer, self.asked = observer, 0
        self.refuses = False

    def needs_no_angles(self, tip: Seen) -> bool:
        return self.observer.needs_no_angles(tip)

    def look(self, positions: Positions, setpoint: Array, preferred: str) -> tuple[Estimate, Array]:
        self.asked += 1
        found = self.observer.look(positions, setpoint, preferred)
        if self.refuses:
            raise PositionsError("vague", "as the test wants it")
        return found


@pytest.fixture
def watched(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> list[Watched]:
    """Those that the stack's loop makes, the last one at the end."""
    made: list[Watched] = []

    def make(name: str, arm: Arm, counters: Counters) -> Watched:
        made.append(Watched(observer_of(name, arm, counters)))
        return made[-1]

    monkeypatch.setattr("armsight_control.loop.observer_of", make)
    stack.loop = stack.new_loop(stack.description)
    stack.reset(all_motion(9.0))
    stack.mode("test-all", start_s=9.0)
    return made


def test_a_command_does_not_wait_for_the_angles_where_the_tip_is_seen(stack: Stack, watched: list[Watched]) -> None:
    for k in range(5):
        answer = stack.step()
        assert (answer.command.hold, watched[-1].asked) == (False, k)
        assert answer.status.joints
        assert len(answer.estimated.joints) == 4
        assert watched[-1].asked == k + 1, "once"


@pytest.mark.parametrize("marker", ["blue", "red"])
def test_a_command_waits_for_the_angles_where_the_tip_is_not_seen(
    stack: Stack, watched: list[Watched], marker: str
) -> None:
    stack.step()
    _ = stack.step(status={marker: MARKER_STATUS_LOST})
    assert watched[-1].asked == 2


def test_a_command_waits_for_the_angles_where_the_tip_is_seen_vaguely(stack: Stack, watched: list[Watched]) -> None:
    stack.capture_ns += PERIOD_NS
    message = stack.look()
    for marker in message.markers:
        if marker.name == "red":
            marker.covariance[:] = (np.eye(3) * 0.1**2).ravel().tolist()
    answer = stack.step(message)
    assert (answer.command.hold, watched[-1].asked) == (False, 1)


@pytest.mark.parametrize("estimator", ["parts", "part2"])
def test_a_command_waits_for_an_estimator_that_may_not_apply(
    stack: Stack, watched: list[Watched], estimator: str
) -> None:
    stack.estimator = estimator
    stack.loop = stack.new_loop(stack.description)
    stack.reset(part2_motion(2.0))
    stack.mode("test-2", start_s=2.0)
    assert not stack.step().command.hold
    assert watched[-1].asked == 1


def test_angles_that_nobody_asked_for_are_followed_all_the_same(stack: Stack, watched: list[Watched]) -> None:
    answers = [stack.step() for _ in range(20)]
    assert watched[-1].asked == 19
    late = [stack.estimate(answer) for answer in answers]
    assert watched[-1].asked == 20
    stack.loop = stack.new_loop(stack.description)
    stack.capture_ns, stack.answered_ns = START_NS, START_NS
    stack.reset(all_motion(9.0))
    stack.mode("test-all", start_s=9.0)
    at_once = [stack.estimate(stack.step()) for _ in range(20)]
    np.testing.assert_array_equal(late, at_once)


def test_the_estimator_follows_an_arm_that_is_not_where_its_setpoint_is(stack: Stack, watched: list[Watched]) -> None:
    stack.step()
    stack.q = -stack.q
    answer = stack.step()
    assert (answer.status.state, answer.command.hold) == (CONTROL_STATE_BLIND, True)
    assert watched[-1].asked == 2


def test_angles_that_can_not_be_told_after_the_command_are_counted(stack: Stack, watched: list[Watched]) -> None:
    before = stack.estimate(stack.step())
    watched[-1].refuses = True
    answer = stack.step()
    assert not answer.command.hold
    np.testing.assert_array_equal(stack.estimate(answer), before)
    assert answer.status.joints
    assert stack.counters.snapshot()["estimate_refused"] == 1
    watched[-1].refuses = False
    assert (stack.estimate(stack.step()) != before).any()


def test_with_every_marker_of_the_last_links_lost_it_goes_blind_and_recovers(stack: Stack) -> None:
    lost = dict.fromkeys(("yellow", "blue", "red"), MARKER_STATUS_LOST)
    stack.reset(all_motion(9.0))
    stack.mode("test-all", start_s=9.0)
    for _ in range(10):
        stack.step()
    sigmas = []
    for _ in range(150):
        answer = stack.step(status=lost)
        if answer.status.state != CONTROL_STATE_BLIND:
            assert not any(joint.observable for joint in answer.status.joints)
            sigmas.append([joint.sigma_rad for joint in answer.status.joints])
    assert (np.diff(sigmas, axis=0) > 0).all(), "what is not seen is known less and less"
    assert 30 < len(sigmas) < 120, "a second or more, not five"
    assert (answer.status.state, answer.command.hold) == (CONTROL_STATE_BLIND, True)
    assert "blue and red can't be seen" in answer.status.detail
    before = stack.q
    answer = stack.step()
    assert answer.status.state == CONTROL_STATE_MOVING
    np.testing.assert_allclose(stack.estimate(answer), before, atol=0.01)


def test_stale_and_implausible_positions_hold(stack: Stack) -> None:
    stack.reset(np.zeros(4))
    stack.mode("joints", np.array([1.0, 0, 0.5, 0.5]))
    assert not stack.step().command.hold
    answer = stack.step(age_s=0.2)
    assert (answer.status.state, answer.command.hold) == (CONTROL_STATE_BLIND, True)
    stack.capture_ns += PERIOD_NS
    wild = stack.look()
    wild.markers[3].position.x += 2.0
    answer = stack.step(wild)
    assert (answer.status.state, answer.command.hold) == (CONTROL_STATE_BLIND, True)
    counted = stack.counters.snapshot()
    assert (counted["held_stale"], counted["held_implausible"]) == (1, 1)


def test_an_arm_that_is_not_where_its_setpoint_is_holds(stack: Stack) -> None:
    stack.reset(np.array([0, 0, 1.4, 0.5]))
    stack.mode("joints", np.zeros(4))
    stack.q = np.array([0, 0, -1.4, -0.5])
    answer = stack.step()
    assert answer.status.state == CONTROL_STATE_BLIND
    assert "is the arm blocked" in answer.status.detail


def test_the_stop_holds_and_names_who_stopped(stack: Stack) -> None:
    stack.reset(np.zeros(4))
    stack.mode("joints", np.array([1.0, 0, 0.5, 0.5]))
    stack.step()
    source = StopSource(name="page", stopped=True, reason="button")
    stack.loop.stop(StopState(stopped=True, sources=[source, StopSource(name="cli")]))
    before = stack.q
    answer = stack.step()
    assert (answer.status.state, answer.command.hold) == (CONTROL_STATE_STOPPED, True)
    assert answer.status.detail == "stopped by page (button): release it to move on"
    assert len(answer.estimated.joints) == 4, "angles are still estimated"
    stack.loop.stop(StopState(stopped=False))
    stack.step()
    assert 0 < np.abs(stack.q - before).max() < 0.02, "it starts from rest"


def test_a_restarted_loop_never_commands_the_twin(stack: Stack) -> None:
    # the pose's twin is (theta - pi, -phi, -psi): every marker in the same place
    pose, goal = np.array([2.0, 0.0, 0.8, 0.6]), np.array([2.3, 0.0, 0.8, 0.6])
    stack.reset(pose)
    stack.mode("joints", goal)
    for _ in range(5):
        stack.step()
    stack.loop = stack.new_loop(stack.description)
    stack.mode("joints", goal)
    before = stack.q
    assert stack.step().command.hold, "without an accepted setpoint it holds"
    stack.loop.accept(stack.states(stack.q))
    for _ in range(60):
        answer = stack.step()
        assert np.abs(stack.q - before).max() < 0.06
        before = stack.q
        np.testing.assert_allclose(stack.estimate(answer)[[0, 2, 3]], stack.q[[0, 2, 3]], atol=0.06)
    np.testing.assert_allclose(stack.q, goal, atol=1e-9)


def test_a_reset_moves_estimate_and_motion_to_the_new_pose(stack: Stack) -> None:
    stack.reset(np.array([2.0, 0.0, 0.8, 0.6]))
    stack.mode("hold")
    stack.step()
    stack.reset(np.array([2.0 - math.pi, 0.0, -0.8, -0.6]))  # the twin, told by the setpoint alone
    np.testing.assert_allclose(stack.estimate(stack.step()), stack.q, atol=1e-6)


def test_track_moves_the_tip_to_the_target(stack: Stack) -> None:
    target = np.array([3.6, 1.0, 7.5])
    stack.reset(np.zeros(4))
    stack.mode("track")
    answer = stack.step()
    assert "no target yet" in answer.status.detail
    message = Point3InFrame(frame_id="world")
    message.point.x, message.point.y, message.point.z = target + np.array([0, 0, 0.5])
    stack.loop.aim(message)
    for _ in range(150):
        wanted = stack.loop.problem()
        if wanted is not None:
            stack.loop.solved(wanted[0], solve("closed-form", wanted[1]))
        answer = stack.step()
    np.testing.assert_allclose(forward(stack.arm.chain, stack.q), target, atol=1e-6)
    status = answer.status
    np.testing.assert_allclose([status.target.x, status.target.y, status.target.z], target, atol=1e-12)
    assert status.target_reachable


def test_track_of_a_target_out_of_reach_goes_to_the_nearest_point_and_says_so(stack: Stack) -> None:
    stack.reset(np.array([0.5, 0.0, 0.5, 0.5]))
    stack.mode("track")
    message = Point3InFrame(frame_id="base")
    message.point.x, message.point.y, message.point.z = 9.0, 0.0, 5.0
    stack.loop.aim(message)
    for _ in range(150):
        wanted = stack.loop.problem()
        if wanted is not None:
            stack.loop.solved(wanted[0], solve("closed-form", wanted[1]))
        answer = stack.step()
    assert not answer.status.target_reachable
    direction = np.array([9.0, 0.0, 1.0]) / math.hypot(9, 1)
    np.testing.assert_allclose(forward(stack.arm.chain, stack.q), [0, 0, 4] + 6 * direction, atol=1e-6)


def test_targets_in_unknown_frames_or_not_finite_are_refused_and_the_last_good_one_stays(stack: Stack) -> None:
    stack.reset(np.zeros(4))
    good = Point3InFrame(frame_id="base")
    good.point.x = 3.0
    stack.loop.aim(good)
    for frame, x in (("camera_1_optical", 1.0), ("", 1.0), ("base", math.nan), ("world", math.inf), ("base", 1e9)):
        bad = Point3InFrame(frame_id=frame)
        bad.point.x = x
        stack.loop.aim(bad)
    assert stack.loop.target is not None
    assert stack.loop.target.position[0] == 3.0
    assert stack.counters.snapshot()["target_refused"] == 5


def test_mode_requests_are_checked_with_a_clear_text(arm: Arm) -> None:
    def request(mode: ControlMode, **angles: float) -> SetModeRequest:
        joints = [JointSetpoint(name=name, position_rad=angle) for name, angle in angles.items()]
        return SetModeRequest(mode=mode, joints=joints)

    zeros = dict.fromkeys(arm.chain.names, 0.0)
    assert mode_of(request(CONTROL_MODE_TRACK), None).mode == CONTROL_MODE_TRACK
    goal = mode_of(request(CONTROL_MODE_JOINTS, **zeros | {"joint3": 0.5}), arm.chain).goal
    assert goal is not None
    np.testing.assert_array_equal(goal, [0, 0, 0.5, 0])
    for error, text, wrong in (
        (
            ModeError,
            "there are hold, joints, test-1, test-2, test-all, track, follow",
            SetModeRequest.FromString(b"\x08\x63"),
        ),
        (SetpointError, "this arm needs joint1", request(CONTROL_MODE_JOINTS, joint1=0.0)),
        (SetpointError, "not finite", request(CONTROL_MODE_JOINTS, **zeros | {"joint1": math.nan})),
        (SetpointError, "outside of its limits", request(CONTROL_MODE_JOINTS, **zeros | {"joint2": 2.0})),
        (ModeError, "start_s", SetModeRequest(mode=CONTROL_MODE_TEST_1, start_s=math.nan)),
    ):
        with pytest.raises(error, match=text):
            mode_of(wrong, arm.chain)
    with pytest.raises(ModeError, match="description has not arrived"):
        mode_of(request(CONTROL_MODE_JOINTS, **zeros), None)


@pytest.mark.parametrize("estimator", ["part1", "part2", "parts"])
def test_an_arm_of_another_shape_is_refused_and_said_by_the_reports_estimators(stack: Stack, estimator: str) -> None:
    del stack.description.joints[1]
    for attached in (*stack.description.markers,):
        attached.centre.joint = "joint1" if attached.centre.joint == "joint2" else attached.centre.joint
    stack.estimator = estimator
    stack.loop = stack.new_loop(stack.description)
    answer = stack.step()
    assert answer.command.hold
    assert f"the estimator {estimator} does not apply" in answer.status.detail
    assert "four joints about z, y, x and y" in answer.status.detail
    stack.loop.tune(MotionOptions(), "all")
    assert stack.loop.arm is not None, "another estimator takes the arm that was refused"
    with pytest.raises(UnsupportedArmError, match="does not apply"):
        stack.loop.tune(MotionOptions(), estimator)
    assert stack.loop.arm is not None


numbers = st.floats(allow_nan=True, allow_infinity=True)


@st.composite
def anything(draw: st.DrawFn) -> tuple[str, object]:
    """One thing that may arrive, good or bad."""
    kind = draw(st.sampled_from(["look", "positions", "accepted", "target", "stop", "mode", "anew", "skip"]))
    return kind, draw(st.lists(numbers, min_size=12, max_size=12))


@given(st.lists(anything(), min_size=1, max_size=25))
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_arrives_in_whatever_order_no_command_breaks_a_limit(
    stack: Stack, arrivals: list[tuple[str, list[float]]]
) -> None:
    stack.loop = stack.new_loop(stack.description)
    stack.reset(np.array([0.3, 0.0, 0.5, -0.5]))
    stack.mode("test-2")
    for kind, values in arrivals:
        if kind == "look":
            stack.step()  # checks limits and speed of the command
        elif kind == "positions":
            message = stack.look()
            message.capture_time.CopyFrom(to_timestamp(stack.capture_ns + PERIOD_NS))
            marker = message.markers[abs(hash(values[0])) % 4]
            marker.position.x, marker.position.y, marker.position.z = values[:3]
            marker.covariance[:] = values[3:12]
            answer = stack.loop.answer(message, values[0])
            if answer is not None and not answer.again:
                stack.capture_ns += PERIOD_NS
                stack.apply(answer)
        elif kind == "accepted":
            stack.accept_wrong(np.array(values[:4]))
        elif kind == "target":
            message_ = Point3InFrame(frame_id="base")
            message_.point.x, message_.point.y, message_.point.z = values[:3]
            stack.loop.aim(message_)
            wanted = stack.loop.problem()
            if wanted is not None:
                stack.loop.solved(wanted[0], solve("closed-form", wanted[1]))
        elif kind == "stop":
            stack.loop.stop(StopState(stopped=values[0] > 0))
        elif kind == "mode":
            names = list(NAMES)
            joints = [
                JointSetpoint(name=name, position_rad=angle)
                for name, angle in zip(stack.arm.chain.names, values, strict=False)
            ]
            request = SetModeRequest(
                mode=NAMES[names[abs(hash(values[4])) % len(names)]], joints=joints, start_s=values[5]
            )
            try:
                stack.loop.set_mode(mode_of(request, stack.arm.chain))
            except ControlError:
                continue
        elif kind == "anew":
            stack.loop.begin_anew()
            stack.reset(stack.q)
            stack.answered_ns = stack.capture_ns  # the first answer of a new sim counts as one of its frames
        else:
            stack.capture_ns += 5 * PERIOD_NS
