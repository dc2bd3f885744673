import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armsight_control.chain import Array, Chain, Point
from armsight_control.description import Arm
from armsight_control.errors import ControlError
from armsight_control.trajectory import (
    Goal,
    MotionLimits,
    OnPath,
    Planner,
    State,
    Step,
    along,
    at_rest,
    part1_motion,
    part2_motion,
    resting,
)

DT_S = 1 / 30
PERIOD_NS = 33_333_333
LIMITS = MotionLimits()
BOUNDS = np.array([[-math.pi, math.pi], *[[-math.pi / 2, math.pi / 2]] * 3])
CHAIN = Chain(("a", "b", "c", "d"), np.zeros((4, 3)), np.eye(4)[:, :3], BOUNDS, np.full(4, 5.0), Point(3, np.zeros(3)))


def moved(chain: Chain, begin: Array, goal: Array, limits: MotionLimits = LIMITS) -> Array:
    planner, states = Planner(chain, limits), [at_rest(begin)]
    while np.abs(states[-1].position - goal).max() > 1e-9 or not np.allclose(states[-1].velocity, 0.0, atol=1e-9):
        states.append(planner.towards(states[-1], resting(goal), DT_S).state)
        assert len(states) < 1000, "it never arrives"
    return np.array([state.position for state in states])


def assert_within_bounds(positions: Array, dt_s: Array, limits: MotionLimits, chain: Chain) -> None:
    """Judged by differences of the setpoints alone."""
    assert (positions >= chain.limits[:, 0]).all()
    assert (positions <= chain.limits[:, 1]).all()
    velocity = np.diff(positions, axis=0) / dt_s[:, None]
    assert (np.abs(velocity) <= limits.speed(chain) + 1e-6).all()
    velocity = np.concatenate([np.zeros((1, chain.count)), velocity])
    between = (np.concatenate([[0.0], dt_s[:-1]]) + dt_s) / 2
    assert (np.abs(np.diff(velocity, axis=0)) <= limits.acceleration_rad_s2 * between[:, None] + 1e-6).all()


def test_a_move_from_rest_goes_straight_within_its_bounds_and_ends_on_its_goal(arm: Arm) -> None:
    begin, goal = np.array([-2.0, 0.5, -1.0, 0.3]), np.array([2.5, -0.5, 1.2, 0.0])
    setpoints = moved(arm.chain, begin, goal)
    shares = (setpoints - begin) / (goal - begin)
    assert np.ptp(shares, axis=1).max() < 1e-6, "all joints are scaled together"
    assert (np.diff(shares[:, 0]) > -1e-12).all(), "it never turns back"
    assert_within_bounds(setpoints, np.full(len(setpoints) - 1, DT_S), LIMITS, arm.chain)
    assert len(setpoints) * DT_S < 4.5 / 1.5 + 1.0


def test_jerk_is_bounded_from_step_to_step() -> None:
    planner, state = Planner(CHAIN, LIMITS), at_rest(np.zeros(4))
    before = state.acceleration
    for _ in range(40):
        state = planner.towards(state, resting(np.array([1.5, 0.0, -1.0, 0.5])), DT_S).state
        assert (np.abs(state.acceleration - before) <= LIMITS.jerk_rad_s3 * DT_S + 1e-9).all()
        before = state.acceleration


def test_a_goal_in_motion_is_met_and_then_kept_up_with() -> None:
    planner, state = Planner(CHAIN, LIMITS), at_rest(np.zeros(4))
    velocity = np.array([0.5, -0.3, 0.0, 0.4])
    for k in range(1, 61):
        goal = np.array([0.5, 0.2, -0.4, 0.1]) + velocity * k * DT_S
        state = planner.towards(state, Goal(goal, velocity), DT_S).state
    np.testing.assert_allclose(state.position, goal, atol=1e-9)
    np.testing.assert_allclose(state.velocity, velocity, atol=1e-9)


def test_a_goal_outside_of_the_limits_is_clipped_and_its_speed_not_followed() -> None:
    planner, state = Planner(CHAIN, LIMITS), at_rest(np.array([0, 1.4, 0, 0]))
    for _ in range(60):
        state = planner.towards(state, Goal(np.array([0, 9.0, 0, 0]), np.array([0, 1.0, 0, 0])), DT_S).state
        assert state.position[1] <= math.pi / 2
    assert state.position[1] == pytest.approx(math.pi / 2, abs=1e-9)


def test_braking_ends_at_rest() -> None:
    planner = Planner(CHAIN, LIMITS)
    state = State(np.zeros(4), np.array([1.5, -1.0, 0.2, 0.0]), np.array([0.0, 6.0, -3.0, 0.0]))
    for _ in range(20):
        state = planner.brake(state, DT_S).state
    assert state.at_rest or np.abs(state.velocity).max() < 1e-12


def test_a_slowed_arm_keeps_to_the_lower_speed() -> None:
    planner, state = Planner(CHAIN, LIMITS), at_rest(np.zeros(4))
    for _ in range(60):
        after = planner.towards(state, resting(np.array([3.0, 0, 0, 0])), DT_S, slow=0.3).state
        assert np.abs(after.position - state.position).max() <= 0.3 * 1.5 * DT_S + 1e-9
        state = after


number = st.floats(-10, 10)


@given(
    st.lists(
        st.tuples(st.lists(number, min_size=8, max_size=8), st.floats(1e-3, 0.1), st.integers(1, 12)),
        min_size=1,
        max_size=12,
    ),
    st.floats(0.05, 1),
    st.floats(1, 20),
    st.floats(5, 300),
)
@settings(max_examples=150, deadline=None)
def test_whatever_goals_come_no_setpoint_breaks_position_speed_or_acceleration(
    goals: list[tuple[list[float], float, int]], share: float, acceleration: float, jerk: float
) -> None:
    limits = MotionLimits(share, acceleration, jerk)
    planner, state = Planner(CHAIN, limits), at_rest(np.zeros(4))
    positions, steps = [state.position], []
    for numbers, dt_s, times in goals:
        goal = Goal(np.array(numbers[:4]), np.array(numbers[4:]))
        for _ in range(times):
            state = planner.towards(state, goal, dt_s).state
            positions.append(state.position)
            steps.append(dt_s)
    assert_within_bounds(np.array(positions), np.array(steps), limits, CHAIN)


def test_the_tests_are_the_reports_sinusoids() -> None:
    np.testing.assert_allclose(part1_motion(5.0), [0, *(math.pi / 2 * np.sin(np.pi * 5 / np.array([15, 20, 18])))])
    np.testing.assert_allclose(part2_motion(14.0)[[0, 1]], [math.pi, 0.0])


def test_a_test_follows_its_path_from_the_instant_at_which_the_arm_is_there() -> None:
    begin_s = 8.0
    path, state = OnPath(begin_s), at_rest(part2_motion(begin_s))
    for k in range(200):
        goal, path = along(part2_motion, path, state, Step(k * PERIOD_NS, DT_S))
        np.testing.assert_allclose(goal.position, part2_motion(begin_s + k * PERIOD_NS / 1e9), atol=1e-12)
        later, now = (part2_motion(begin_s + k * PERIOD_NS / 1e9 + h) for h in (1e-6, 0.0))
        np.testing.assert_allclose(goal.velocity, (later - now) / 1e-6 if k else np.zeros(4), atol=1e-5)
        state = State(goal.position, goal.velocity, np.zeros(4))


def test_a_test_first_moves_to_where_it_begins_and_goes_on_after_an_interruption(arm: Arm) -> None:
    planner, state, path = Planner(arm.chain, LIMITS), at_rest(np.array([0.5, 0.5, 0.0, 0.0])), OnPath(2.0)
    for k in range(300):
        if k == 150:  # held for a while: the path waits where it was
            path, state, at_interruption = path.left(), at_rest(state.position), path.time_s
            assert at_interruption > 2.5
        goal, path = along(part1_motion, path, state, Step((k + 90 * (k >= 150)) * PERIOD_NS, DT_S))
        state = planner.towards(state, goal, DT_S).state
        if 150 <= k < 155:
            assert path.time_s == pytest.approx(at_interruption, abs=0.2)
    np.testing.assert_allclose(state.position, part1_motion(path.time_s), atol=1e-4)


def test_limits_that_no_motion_can_keep_are_refused() -> None:
    for limits in ((0.0, 6, 60), (1.5, 6, 60), (math.nan, 6, 60), (0.3, 0.0, 60), (0.3, math.inf, 60), (0.3, 6, 0.0)):
        with pytest.raises(ControlError, match="not"):
            MotionLimits(*limits)
