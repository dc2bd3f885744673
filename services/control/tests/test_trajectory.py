import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armsight_control.chain import Array
from armsight_control.description import Arm
from armsight_control.errors import ControlError
from armsight_control.trajectory import (
    Motion,
    MotionLimits,
    OnPath,
    Step,
    along,
    part1_motion,
    part2_motion,
    towards,
)

DT_S = 1 / 30
LIMITS = MotionLimits()


def moved(arm: Arm, begin: Array, goal: Array, limits: MotionLimits = LIMITS) -> Array:
    setpoints, motion = [begin], Motion()
    while np.abs(setpoints[-1] - goal).max() > 1e-9:
        setpoint, motion = towards(arm.chain, setpoints[-1], goal, DT_S, motion, limits)
        setpoints.append(setpoint)
        assert len(setpoints) < 1000, "it never arrives"
    return np.array(setpoints)


def test_a_move_goes_straight_within_speed_and_ends_on_its_goal(arm: Arm) -> None:
    begin, goal = np.array([-2.0, 0.5, -1.0, 0.3]), np.array([2.5, -0.5, 1.2, 0.0])
    setpoints = moved(arm, begin, goal)
    shares = (setpoints - begin) / (goal - begin)
    assert np.ptp(shares, axis=1).max() < 1e-9, "all joints are scaled together"
    assert (np.diff(shares[:, 0]) > 0).all(), "it never turns back"
    speed = np.abs(np.diff(setpoints, axis=0)) / DT_S
    assert (speed <= arm.chain.max_speed * LIMITS.speed_share + 1e-9).all()
    assert len(setpoints) * DT_S < 4.5 / 1.5 + 1.0


def test_a_move_starts_and_ends_gently(arm: Arm) -> None:
    setpoints = moved(arm, np.zeros(4), np.array([1.5, 0.0, 0.0, 0.0]))
    speed = np.diff(setpoints[:, 0]) / DT_S
    change = np.abs(np.diff(np.concatenate([[0.0], speed, [0.0]])))
    ramp = 5 * LIMITS.speed_share * DT_S / LIMITS.ramp_s
    assert change[: len(change) // 2].max() <= ramp + 1e-9
    assert change.max() < 2 * ramp, "braking at discrete instants ends a little harder than it begins"


def test_a_goal_outside_of_the_limits_is_clipped(arm: Arm) -> None:
    setpoint, _ = towards(arm.chain, np.array([0, 1.57, 0, 0]), np.array([0, 9.0, 0, 0]), DT_S, Motion(1.0), LIMITS)
    assert setpoint[1] <= math.pi / 2


def test_the_tests_are_the_reports_sinusoids() -> None:
    np.testing.assert_allclose(part1_motion(5.0), [0, *(math.pi / 2 * np.sin(np.pi * 5 / np.array([15, 20, 18])))])
    np.testing.assert_allclose(part2_motion(14.0)[[0, 1]], [math.pi, 0.0])


def test_a_test_follows_its_path_from_the_instant_at_which_the_arm_is_there(arm: Arm) -> None:
    begin_s, period_ns = 8.0, 33_333_333
    setpoint, path, motion = part2_motion(begin_s), OnPath(begin_s), Motion()
    for k in range(200):
        setpoint, path, motion = along(
            arm.chain, part2_motion, path, setpoint, Step(k * period_ns, DT_S), motion, LIMITS
        )
        np.testing.assert_allclose(setpoint, arm.chain.clip(part2_motion(begin_s + k * period_ns / 1e9)), atol=1e-12)


def test_a_test_first_moves_to_where_it_begins_and_goes_on_after_an_interruption(arm: Arm) -> None:
    setpoint, path, motion = np.array([0.5, 0.5, 0.0, 0.0]), OnPath(2.0), Motion()
    steps = []
    for k in range(200):
        if k == 100:  # held for a while: the path waits where it was
            path, motion = path.left(), Motion()
        before = setpoint
        setpoint, path, motion = along(
            arm.chain, part1_motion, path, setpoint, Step((k + 90 * (k >= 100)) * 33_333_333, DT_S), motion, LIMITS
        )
        steps.append(np.abs(setpoint - before).max())
        if k == 99:
            at_interruption = path.time_s
        if k == 101:
            assert path.time_s == pytest.approx(at_interruption + DT_S, abs=1e-6)
    assert path.anchor is not None
    assert max(steps) <= 5 * 0.3 * DT_S + 1e-9


@given(
    st.lists(st.floats(-10, 10), min_size=8, max_size=8),
    st.floats(1e-6, 0.1),
    st.floats(0, 1),
    st.floats(0.01, 1),
    st.floats(0.01, 10),
)
def test_no_step_breaks_speed_or_limits(
    numbers: list[float], dt_s: float, speed: float, share: float, ramp_s: float
) -> None:
    from armsight_control.chain import Chain, Point

    limits = np.array([[-math.pi, math.pi], *[[-math.pi / 2, math.pi / 2]] * 3])
    names = ("a", "b", "c", "d")
    chain = Chain(names, np.zeros((4, 3)), np.eye(4)[:, :3], limits, np.full(4, 5.0), Point(3, np.zeros(3)))
    begin, goal = chain.clip(np.array(numbers[:4])), np.array(numbers[4:])
    setpoint, after = towards(chain, begin, goal, dt_s, Motion(speed), MotionLimits(share, ramp_s))
    assert (np.abs(setpoint - begin) <= 5 * dt_s + 1e-6).all()
    assert (setpoint == chain.clip(setpoint)).all()
    assert 0 <= after.speed <= 1


def test_limits_that_no_motion_can_keep_are_refused() -> None:
    for share, ramp_s in ((0.0, 0.25), (1.5, 0.25), (math.nan, 0.25), (0.3, 0.0), (0.3, math.inf)):
        with pytest.raises(ControlError, match="not"):
            MotionLimits(share, ramp_s)
