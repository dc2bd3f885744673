"""Motion at its bars: sim's physics and control's loop in one process, and the whole stack in lockstep."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Point3InFrame_pb2 import Point3InFrame
from hypothesis import given, settings
from hypothesis import strategies as st
from in_process import BASE, BODIES, MARKERS, Bench, Moment, Vector, clearance_of, rms

from armsight import topics
from armsight.bus import Received
from armsight.times import NS_PER_S, from_timestamp
from armsight.v1.control_pb2 import (
    CONTROL_STATE_HOLDING,
    CONTROL_STATE_MOVING,
    SAFETY_CODE_BODY_LOST,
    SAFETY_CODE_BRANCH_SWITCH,
    SAFETY_CODE_SLOWED_FOR_BODY,
    SAFETY_CODE_SLOWED_FOR_SINGULARITY,
    SAFETY_CODE_STOPPED,
    ControlStatus,
)
from armsight_control import estimators
from armsight_control.detour import KEEP_M
from armsight_control.modes import NAMES, Mode
from armsight_control.movement import MotionOptions
from armsight_sim.targets import TARGETS
from armsight_sim.world import load_model, longer_links
from rig import Rig

pytestmark = pytest.mark.untimed

START = "2024-05-01T12:00:00Z"


def target_at(name: str, t: float) -> Vector:
    frame, point = TARGETS[name]
    return np.array(point(t)) - (BASE if frame == "world" else 0.0)


def tip_errors(moments: list[Moment], target: str) -> Vector:
    return np.array([np.linalg.norm(moment.tip - target_at(target, moment.t)) for moment in moments])


def beside_errors(moments: list[Moment]) -> Vector:
    """From the nearer of the two points 1 m from the sphere's centre, on the line to the shoulder."""
    errors = []
    for moment in moments:
        centre, shoulder = target_at("visible", moment.t), np.array([0.0, 0.0, 4.0])
        along = (centre - shoulder) / np.linalg.norm(centre - shoulder)
        errors.append(min(np.linalg.norm(moment.tip - centre - side * along) for side in (-1, 1)))
    return np.array(errors)


def assert_bounds(bench: Bench) -> None:
    """No command breaks position, speed or acceleration, by differences to the setpoint in force."""
    limits, ends = bench.limits, bench.world.limits
    before, speed, before_s = None, np.zeros(4), 0.0
    for moment in bench.moments:
        lapsed = moment.dt_s > 0.1
        if before is None or lapsed or np.abs(before - moment.in_force).max() > 1e-9:
            speed, before_s = np.zeros(4), 0.0  # held, reset or stopped: it begins anew, from rest
        before = moment.command
        if before is None:
            continue
        dt_s = 1 / 30 if lapsed else moment.dt_s
        now = (before - moment.in_force) / dt_s
        assert (before >= ends[:, 0]).all()
        assert (before <= ends[:, 1]).all()
        assert np.abs(now).max() <= 5 * limits.speed_share + 1e-6
        assert np.abs(now - speed).max() <= limits.acceleration_rad_s2 * (dt_s + before_s) / 2 + 1e-5
        speed, before_s = now, dt_s


@pytest.mark.parametrize("free", ["3", "all"])
def test_the_tip_keeps_up_with_the_default_target(free: str) -> None:
    bench = Bench("track", "default", motion=MotionOptions(free_joints=free))
    bench.run(2)
    assert rms(tip_errors(bench.run(8), "default")) < 0.002
    assert_bounds(bench)


def test_the_tip_keeps_up_with_the_exercises_target_where_it_is_reached_and_says_where_not() -> None:
    bench = Bench("track", "exercise")
    moments = bench.run(12)
    reached = np.array([moment.status.target_reachable for moment in moments])
    errors = tip_errors(moments, "exercise")
    settled = np.arange(len(moments)) > 100
    assert 0.2 < reached.mean() < 0.8
    assert rms(errors[reached & settled]) < 0.02
    for moment in moments:
        assert moment.status.target_reachable != ("out of reach" in moment.status.detail)
    assert_bounds(bench)


@pytest.mark.parametrize("error", [0.01, -0.01])
def test_an_arm_whose_links_are_not_as_described_reaches_the_target_as_seen(error: float) -> None:
    bench = Bench("track", "default", model_error=error, sigma_m=0.002, seed=7)
    bench.run(3)
    moments = bench.run(5)
    assert rms(tip_errors(moments, "default")) < 0.005
    correction = moments[-1].status.correction
    assert 0.03 < np.linalg.norm([correction.x, correction.y, correction.z]) < 0.12
    assert_bounds(bench)


@pytest.mark.parametrize("free", ["3", "all"])
def test_the_tip_stays_a_metre_from_the_sphere_wherever_that_is_reached(free: str) -> None:
    bench = Bench("follow", sigma_m=0.003, motion=MotionOptions(free_joints=free), seed=3)
    bench.run(3)
    moments = bench.run(6)
    assert all(moment.status.target_reachable for moment in moments)
    assert rms(beside_errors(moments)) < 0.04
    assert_bounds(bench)


def test_a_box_that_is_taken_for_the_sphere_for_some_frames_moves_nothing() -> None:
    bench = Bench("follow", mistaken=lambda t: any(abs(t - middle) < 0.06 for middle in (3.6, 3.9, 5.0)))
    bench.run(3)
    assert rms(beside_errors(bench.run(4))) < 0.02
    assert bench.counters.snapshot()["body_jump"] > 5
    assert_bounds(bench)


def test_a_branch_is_left_while_the_sphere_is_out_of_reach_so_that_it_lasts_while_it_is_in_reach() -> None:
    bench = Bench("follow", sigma_m=0.003, seed=3)
    bench.run(4)
    moments = bench.run(36)
    assert bench.counters.snapshot()["branch_switch"] == 1
    switching = [moment for moment in moments if moment.status.safety == SAFETY_CODE_BRANCH_SWITCH]
    assert switching
    assert not any(moment.status.target_reachable for moment in switching)
    assert rms(beside_errors([moment for moment in moments if moment.status.target_reachable])) < 0.04
    assert_bounds(bench)


def test_a_sphere_that_vanishes_is_foreseen_briefly_and_then_waited_for() -> None:
    bench = Bench("follow", lost=lambda t, name: name == "target_sphere" and 4 <= t < 7)
    bench.run(4)
    foreseen, waiting, again = bench.run(0.9), bench.run(2.1), bench.run(3)
    assert rms(beside_errors(foreseen)) < 0.04
    assert all(moment.status.state == CONTROL_STATE_MOVING for moment in foreseen)
    last = waiting[-1]
    assert (last.status.state, last.status.safety) == (CONTROL_STATE_HOLDING, SAFETY_CODE_BODY_LOST)
    assert "target_sphere is not seen" in last.status.detail
    assert last.command is None
    assert rms(beside_errors(again[60:])) < 0.04
    assert_bounds(bench)


@pytest.mark.parametrize(("free", "pose"), [("3", (0.0, 0.0, 0.0, 0.0)), ("all", (2.0, 0.0, 0.7, 0.8))])
def test_links_keep_off_the_box_when_asked_to(free: str, pose: tuple[float, ...]) -> None:
    careless = Bench("track", "exercise", pose, motion=MotionOptions(free_joints=free))
    assert min(moment.clearance_m for moment in careless.run(2.5)) < KEEP_M, "the box is in the way of this motion"
    careful = Bench("track", "exercise", pose, motion=MotionOptions(free_joints=free, avoid_box=True), sigma_m=0.005)
    moments = careful.run(5)
    assert min(moment.clearance_m for moment in moments) >= KEEP_M
    assert any(moment.status.safety == SAFETY_CODE_SLOWED_FOR_BODY for moment in moments)
    assert careful.counters.snapshot()["safety_slowed_for_body"] > 0
    reached = [moment for moment in moments[110:] if moment.status.target_reachable]
    assert rms(tip_errors(reached, "exercise")) < 0.02, "it gets there all the same"
    assert_bounds(careful)


def test_a_stop_in_the_middle_of_a_motion_and_its_release_go_without_a_step() -> None:
    bench = Bench("track", "default")
    bench.run(0.6)
    assert np.abs(bench.world.speeds()).max() > 0.5, "it is on its way"
    bench.stop()
    halted = bench.run(1)
    assert all(moment.status.safety == SAFETY_CODE_STOPPED and moment.command is None for moment in halted)
    assert bench.counters.snapshot()["safety_stopped"] == 30
    assert np.abs(bench.world.speeds()).max() < 1e-3
    stood = bench.world.angles()
    bench.release()
    moments = bench.run(3)
    steps = np.diff([stood, *(moment.q for moment in moments)], axis=0)
    assert np.abs(steps[0]).max() < 1e-3
    speeds = steps * 30
    assert np.abs(speeds).max() <= 1.05 * 5 * bench.limits.speed_share
    # the arm's own: its actuators' response is on top of the setpoint's acceleration, whose bound is exact
    assert np.abs(np.diff(speeds, axis=0)).max() <= 2 * bench.limits.acceleration_rad_s2 / 30
    assert_bounds(bench)
    assert rms(tip_errors(moments[-15:], "default")) < 0.02


def test_on_the_way_into_a_singularity_it_slows_down_and_says_so() -> None:
    # from a bent arm to a point straight above, which only a stretched one reaches
    bench = Bench("track", pose=(0.4, 0.0, 0.5, -0.9))
    bench.loop.aim(Point3InFrame(frame_id="base", point=Point3(x=0.2, y=0.1, z=10.5)))
    moments = bench.run(4)
    slowed = [moment for moment in moments if moment.status.safety == SAFETY_CODE_SLOWED_FOR_SINGULARITY]
    assert slowed
    assert bench.counters.snapshot()["safety_slowed_for_singularity"] == len(slowed)
    speeds = [np.abs(moment.command - moment.in_force).max() * 30 for moment in slowed if moment.command is not None]
    assert max(speeds[len(speeds) // 2 :]) < 0.31 * 5 * bench.limits.speed_share, "as slow as it gets, once it is near"
    assert moments[-1].status.state == CONTROL_STATE_HOLDING, "it comes to rest there all the same"
    assert_bounds(bench)


def test_speed_lowered_in_the_middle_of_a_motion_is_kept_soon_and_raised_again() -> None:
    bench = Bench("joints")
    bench.loop.set_mode(Mode(NAMES["joints"], np.array([2.5, 0.0, 0.0, 0.0])))

    def speeds(moments: list[Moment]) -> Vector:
        return np.array([(m.command - m.in_force)[0] * 30 for m in moments if m.command is not None])

    whole = 5 * bench.limits.speed_share
    assert speeds(bench.run(0.7))[-1] == pytest.approx(whole, rel=1e-3)
    bench.loop.tune(MotionOptions(slow=0.2), bench.estimator)
    lowered = speeds(bench.run(0.7))
    assert lowered[-1] == pytest.approx(0.2 * whole, rel=1e-3)
    assert 0 <= lowered.min() <= lowered.max() <= whole, "it neither turns round nor goes on faster"
    bench.loop.tune(MotionOptions(), bench.estimator)
    assert speeds(bench.run(0.7)).max() == pytest.approx(whole, rel=1e-3)
    assert_bounds(bench)


def test_another_standoff_is_taken_while_the_sphere_is_followed() -> None:
    bench = Bench("follow", "visible", motion=MotionOptions(free_joints="all"))
    bench.run(4)
    bench.loop.tune(MotionOptions(free_joints="all", standoff_m=1.6), bench.estimator)
    bench.run(3)
    distances = [np.linalg.norm(m.tip - target_at("visible", m.t)) for m in bench.run(1)]
    assert rms(np.array(distances) - 1.6) < 0.04


EVENTS = (
    "run",
    "run",
    "run",
    "mode",
    "target",
    "point",
    "stop",
    "release",
    "lose",
    "see",
    "noise",
    "reset",
    "skip",
    "tune",
)


def happens(bench: Bench, event: str, rng: np.random.Generator) -> None:
    """One thing that may happen to control, and what comes of it in up to a second."""
    poses = bench.world.limits
    if event == "mode":
        bench.mode = str(rng.choice(list(NAMES)))
        goal, start_s = rng.uniform(poses[:, 0], poses[:, 1]), rng.uniform(0, 60)
        bench.loop.set_mode(Mode(NAMES[bench.mode], goal, start_s))
    elif event == "target":
        bench.target = str(rng.choice(["none", *TARGETS]))
    elif event == "point":
        x, y, z = rng.uniform((-7, -7, -1), (7, 7, 11))
        bench.loop.aim(Point3InFrame(frame_id="base", point=Point3(x=x, y=y, z=z if rng.random() < 0.9 else np.nan)))
    elif event == "stop":
        bench.stop()
    elif event == "release":
        bench.release()
    elif event == "lose":
        names = set(rng.choice((*MARKERS, *BODIES), size=rng.integers(1, 5)))
        bench.lost = lambda _t, name: name in names
    elif event == "see":
        bench.lost, bench.sigma_m = (lambda _t, _name: False), 0.0
    elif event == "noise":
        bench.sigma_m = float(rng.choice([0.003, 0.03, 0.5]))
    elif event == "reset":
        bench.reset(rng.uniform(poses[:, 0], poses[:, 1]))
    elif event == "skip":
        bench.skip(int(rng.integers(1, 8)))
    elif event == "tune":
        free, avoid = str(rng.choice(["3", "all"])), bool(rng.random() < 0.5)
        slow, standoff_m, time_s = rng.uniform(0.04, 1), rng.uniform(0.5, 2), rng.uniform(0.05, 10)
        way = MotionOptions(free, avoid, slow, standoff_m, time_s)
        bench.loop.tune(way, str(rng.choice(estimators.NAMES)))
    bench.run(rng.integers(1, 31) / 30)


@given(
    st.lists(st.sampled_from(EVENTS), min_size=3, max_size=12),
    st.sampled_from(["3", "all"]),
    st.booleans(),
    st.integers(0, 2**32 - 1),
)
@settings(max_examples=25, deadline=None)
def test_whatever_happens_in_whatever_order_no_command_breaks_a_limit(
    events: list[str], free: str, avoid_box: bool, seed: int
) -> None:
    bench = Bench("track", "default", motion=MotionOptions(free_joints=free, avoid_box=avoid_box), seed=seed)
    for event in events:
        happens(bench, event, bench.rng)
    assert_bounds(bench)
    assert "safety_halted_unsafe" not in bench.counters.snapshot(), "the last word was never needed"


# --- the whole stack


def recorded(
    rig: Rig, instants: int, *, model_error: float = 0.0, begin: Callable[[], None] = lambda: None
) -> list[Moment]:
    """True tips and statuses from the start on, joined by instant; ``begin`` is called once sim is there."""
    statuses: dict[int, ControlStatus] = {}
    truths: dict[int, JointStates] = {}

    def keep_status(got: Received[ControlStatus]) -> None:
        statuses.setdefault(from_timestamp(got.message.capture_time), got.message)

    def keep_truth(got: Received[JointStates]) -> None:
        truths.setdefault(from_timestamp(got.message.timestamp), got.message)

    for name in ("router", "vision", "control"):
        rig.start(name)
    rig.bus.subscriber(topics.CONTROL_STATUS, keep=1000, on_message=keep_status)
    rig.bus.subscriber(topics.JOINTS_TRUE, keep=1000, on_message=keep_truth)
    rig.wait_until(lambda: rig.heard_of("vision") and rig.heard_of("control"), 20, "vision and control are there")
    rig.start("sim")
    rig.wait_until(lambda: len(statuses) > 1, 20, "the first answers")
    begin()
    rig.wait_until(lambda: min(len(truths), len(statuses)) > instants, 120, f"{instants} instants")
    data = mujoco.MjData(model := longer_links(load_model(), model_error))
    first = min(truths)
    moments = []
    for stamp in sorted(set(truths) & set(statuses))[:instants]:
        data.qpos[:] = [joint.position for joint in truths[stamp].joints]
        mujoco.mj_kinematics(model, data)
        tip, t = np.array(data.site("tip").xpos) - BASE, (stamp - first) / NS_PER_S
        moments.append(Moment(t, tip, data.qpos.copy(), np.zeros(4), 0.0, None, statuses[stamp], clearance_of(data, t)))
    return moments


def test_through_the_whole_stack_the_tip_keeps_up_with_the_default_target(make_rig: Callable[..., Rig]) -> None:
    rig = make_rig(clock="lockstep", start_time=START, target="default", mode="track")
    moments = recorded(rig, 150)
    assert rms(tip_errors(moments[90:], "default")) < 0.02


def test_through_the_whole_stack_the_tip_keeps_up_with_the_exercises_target(make_rig: Callable[..., Rig]) -> None:
    rig = make_rig(clock="lockstep", start_time=START, target="exercise", mode="track")
    reached = [moment for moment in recorded(rig, 210)[100:] if moment.status.target_reachable]
    assert len(reached) > 60
    assert rms(tip_errors(reached, "exercise")) < 0.02


@pytest.mark.parametrize("error", [0.01, -0.01])
def test_through_the_whole_stack_an_arm_that_is_not_as_described_reaches_the_target(
    make_rig: Callable[..., Rig], error: float
) -> None:
    extra = {"sim": ["--model-error", str(error)]}
    rig = make_rig(clock="lockstep", start_time=START, target="default", mode="track", extra=extra)
    moments = recorded(rig, 180, model_error=error)
    assert rms(tip_errors(moments[120:], "default")) < 0.005


def test_through_the_whole_stack_the_tip_stays_a_metre_from_the_sphere(make_rig: Callable[..., Rig]) -> None:
    rig = make_rig(clock="lockstep", start_time=START, target="visible", mode="follow")
    moments = recorded(rig, 180)
    reached = [moment for moment in moments[90:] if moment.status.target_reachable]
    assert len(reached) > 60
    assert rms(beside_errors(reached)) < 0.04


@pytest.mark.parametrize("avoid", [False, True])
def test_through_the_whole_stack_the_links_keep_off_the_box(make_rig: Callable[..., Rig], avoid: bool) -> None:
    # joint 1 turns the arm through where the box is
    begin, end = (-2.2, 0.0, -1.0, 0.3), (0.2, 0.0, -1.0, 0.3)
    extra = {"sim": ["--pose", *map(str, begin)], "control": ["--avoid-box"] if avoid else []}
    rig = make_rig(clock="lockstep", start_time=START, target="visible", mode="hold", extra=extra)
    moments = recorded(rig, 150, begin=lambda: rig.mode("joints", end))
    least = min(moment.clearance_m for moment in moments)
    assert (least >= KEEP_M) == avoid, f"{least:.2f} m"
