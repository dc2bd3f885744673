import numpy as np
import pytest

from armsight.times import to_duration, to_timestamp
from armsight.v1.joints_pb2 import JointCommand, JointSetpoint
from armsight_sim.clock import WATCHDOG_S, Instants
from armsight_sim.commands import Verdict
from armsight_sim.motion import Motion
from armsight_sim.world import World

START = 1_700_000_000_000_000_000
JOINTS = ("joint1", "joint2", "joint3", "joint4")


@pytest.fixture
def motion(world: World) -> Motion:
    return Motion(world, Instants(START, 30), np.zeros(4))


def move(motion: Motion, angle: float, *, stopped: bool = False, hold: bool = False) -> Verdict:
    command = JointCommand(
        answers=to_timestamp(motion.capture_ns),
        valid_for=to_duration(0.1),
        hold=hold,
        joints=[JointSetpoint(name=name, position_rad=angle if name == "joint1" else 0.0) for name in JOINTS],
    )
    return motion.command(command, stopped=stopped).verdict


def test_arm_follows_fresh_commands(motion: Motion) -> None:
    for frame in range(60):
        assert move(motion, 0.01 * frame) is Verdict.MOVE
        motion.next_frame()
    assert motion.world.angles()[0] == pytest.approx(0.59, abs=0.01)
    assert motion.watchdog_trips == 0


def test_arm_decelerates_and_holds_when_commands_stop(motion: Motion) -> None:
    move(motion, 3.0)
    frames = 0
    while frames == 0 or np.abs(motion.world.speeds()).max() > 1e-3:
        motion.next_frame()
        frames += 1
        assert frames < 60, "the arm never came to rest"
    assert motion.watchdog_trips == 1
    # it may move for the watchdog's time and then as long as braking takes
    assert frames / 30 < WATCHDOG_S + 0.6
    assert motion.world.angles()[0] < 1.0
    np.testing.assert_allclose(motion.accepted, motion.world.angles(), atol=1e-4)


def test_hold_does_not_feed_the_watchdog(motion: Motion) -> None:
    move(motion, 3.0)
    for _ in range(10):
        motion.next_frame()
        move(motion, 0.0, hold=True)
    assert motion.watchdog_trips == 1


def test_stop_halts_at_once_and_motion_is_refused(motion: Motion) -> None:
    move(motion, 3.0)
    motion.next_frame()
    motion.halt()
    assert move(motion, 3.0, stopped=True) is Verdict.REFUSE
    for _ in range(30):
        motion.next_frame()
    assert np.abs(motion.world.speeds()).max() < 1e-6


def test_reset_takes_effect_from_the_next_frame_and_time_goes_on(motion: Motion) -> None:
    for _ in range(5):
        motion.next_frame()
    pose = np.array([0.3, -0.2, 0.5, 0.1])
    before = motion.capture_ns
    first = motion.reset(pose)
    assert move(motion, 1.0) is Verdict.REFUSE, "it answers what was seen before the reset"
    motion.next_frame()
    assert motion.capture_ns == first > before
    np.testing.assert_allclose(motion.world.angles(), pose, atol=1e-6)
    assert move(motion, 0.3) is Verdict.MOVE


def test_arm_stays_within_its_limits_whatever_is_allowed(motion: Motion) -> None:
    lower, upper = motion.world.limits[0]
    farthest = 0.0
    for frame in range(240):
        # from end to end, and turned round at full speed shortly before the end
        move(motion, upper if frame % 60 < 40 else lower)
        motion.next_frame()
        farthest = max(farthest, abs(motion.world.angles()[0]))
    assert farthest <= upper + 0.01
    assert farthest >= upper - 0.01
