import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import example, given, settings
from hypothesis.extra.numpy import arrays
from hypothesis.strategies import floats, integers, lists

from armsight_sim.setpoint import MAX_ACCELERATION_RAD_S2, Setpoint

Vector = npt.NDArray[np.float64]
DT = 0.002
SPEED = np.full(4, 5.0)
LIMITS = np.array([[-3.1, 3.1], [-1.6, 1.6], [-1.6, 1.6], [-1.6, 1.6]])


@pytest.fixture
def setpoint() -> Setpoint:
    return Setpoint(np.zeros(4), LIMITS, SPEED, 1 / 30)


def run(setpoint: Setpoint, seconds: float) -> Vector:
    speeds = []
    for _ in range(round(seconds / DT)):
        setpoint.step(DT)
        speeds.append(setpoint.speed.copy())
    return np.array(speeds)


def test_far_goal_is_approached_within_speed_and_acceleration(setpoint: Setpoint) -> None:
    setpoint.command(np.array([3.0, -1.0, 0.5, 0.0]))
    speeds = run(setpoint, 3.0)
    assert np.abs(speeds).max() <= 5.0 + 1e-9
    assert np.abs(np.diff(speeds, axis=0)).max() <= MAX_ACCELERATION_RAD_S2 * DT * 1.05
    np.testing.assert_allclose(setpoint.position, [3.0, -1.0, 0.5, 0.0])
    assert setpoint.at_rest


def test_all_joints_keep_the_direction_that_was_asked_for(setpoint: Setpoint) -> None:
    goal = np.array([2.0, 1.0, 0.0, -0.5])
    setpoint.command(goal)
    for _ in range(100):
        setpoint.step(DT)
        np.testing.assert_allclose(np.cross(setpoint.position[:3], goal[:3]), 0.0, atol=1e-9)


def test_braking_ends_at_rest_and_stays_there(setpoint: Setpoint) -> None:
    setpoint.command(np.array([3.0, 0.0, 0.0, 0.0]))
    run(setpoint, 0.4)
    before = setpoint.position.copy()
    speed = float(setpoint.speed[0])
    assert speed > 1.0
    setpoint.brake()
    run(setpoint, 1.0)
    travelled = float(setpoint.position[0] - before[0])
    assert travelled == pytest.approx(speed**2 / 2 / MAX_ACCELERATION_RAD_S2, rel=0.1)
    assert setpoint.at_rest
    held = setpoint.position.copy()
    run(setpoint, 0.5)
    np.testing.assert_array_equal(setpoint.position, held)


def test_accepted_is_the_command_where_the_speed_limit_lets_it(setpoint: Setpoint) -> None:
    near, far = np.array([0.1, 0.0, 0.0, 0.0]), np.array([3.0, 0.0, 0.0, 0.0])
    setpoint.command(near)
    np.testing.assert_array_equal(setpoint.accepted, near)
    setpoint.command(far)
    np.testing.assert_array_equal(setpoint.accepted, setpoint.position)
    run(setpoint, 0.3)
    setpoint.brake()
    run(setpoint, 1.0)
    np.testing.assert_array_equal(setpoint.accepted, setpoint.position)
    assert setpoint.accepted[0] < 3.0


@settings(deadline=None)
@given(
    start=arrays(np.float64, 4, elements=floats(0.0, 1.0)),
    goals=lists(arrays(np.float64, 4, elements=floats(0.0, 1.0)), min_size=1, max_size=4),
    steps=integers(1, 400),
)
# joint 2 nears its end when joint 1 is turned round: braking in proportion would leave too little for joint 2
@example(start=np.array([1.0, 0.0, 0.5, 0.5]), goals=[np.array([0.48, 1.0, 0.5, 0.5]), np.ones(4)], steps=315)
def test_no_order_of_allowed_commands_takes_it_beyond_a_limit(start: Vector, goals: list[Vector], steps: int) -> None:
    lower, upper = LIMITS.T
    setpoint = Setpoint(lower + start * (upper - lower), LIMITS, SPEED, 1 / 30)
    for goal in goals:
        setpoint.command(lower + goal * (upper - lower))
        for _ in range(steps):
            before = setpoint.speed.copy()
            setpoint.step(DT)
            assert (lower <= setpoint.position).all()
            assert (setpoint.position <= upper).all()
            assert np.abs(setpoint.speed - before).max() <= MAX_ACCELERATION_RAD_S2 * DT + 1e-9
