import numpy as np
import numpy.typing as npt
import pytest

from armsight_sim.errors import PoseError
from armsight_sim.world import World, load_model, longer_links

Vector = npt.NDArray[np.float64]
SEED = 8128

# reference of the markers at q = 0, world frame: the report's arm with the offsets of the spheres
AT_ZERO = {"green": (0, 0, 0.85), "yellow": (0, 0, 4.80), "blue": (0, 0, 7.90), "red": (0, 0, 10.65)}


def tip(q: Vector) -> Vector:
    """K for all four joints by plain rotation matrices, world frame."""
    theta, nu, phi, psi = q

    def turn(axis: int, angle: float) -> Vector:
        c, s = np.cos(angle), np.sin(angle)
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        matrix = np.eye(3)
        matrix[i, i] = matrix[j, j] = c
        matrix[i, j], matrix[j, i] = -s, s
        return matrix

    r = turn(2, theta) @ turn(1, nu) @ turn(0, phi)
    up = np.array([0.0, 0.0, 1.0])
    return np.asarray(np.array([0, 0, 4.5]) + 3.2 * r @ up + 2.8 * r @ turn(1, psi) @ up)


def settle(world: World, setpoint: Vector, seconds: float) -> None:
    for _ in range(round(seconds / world.step_s)):
        world.step(setpoint, np.zeros(4))


def test_markers_are_where_the_report_has_them_at_zero(world: World) -> None:
    for name, position in AT_ZERO.items():
        np.testing.assert_allclose(world.data.geom(f"marker_{name}").xpos, position, atol=1e-12)


def test_tip_is_the_closed_form_on_random_poses(world: World) -> None:
    random = np.random.default_rng(SEED)
    for _ in range(200):
        q = random.uniform(world.limits[:, 0], world.limits[:, 1])
        world.reset(q)
        np.testing.assert_allclose(world.data.site("tip").xpos, tip(q), atol=1e-12, err_msg=f"seed {SEED}")


def test_twin_puts_every_marker_in_the_same_place(world: World) -> None:
    random = np.random.default_rng(SEED + 1)
    for _ in range(50):
        q = random.uniform(world.limits[:, 0], world.limits[:, 1])
        twin = np.array([q[0] - np.sign(q[0]) * np.pi, -q[1], -q[2], -q[3]])
        centres = []
        for pose in (q, twin):
            world.reset(pose)
            centres.append([world.data.geom(f"marker_{name}").xpos.copy() for name in AT_ZERO])
        np.testing.assert_allclose(centres[0], centres[1], atol=1e-12)


def test_limits_and_speeds_are_the_reports(world: World) -> None:
    half = np.pi / 2
    np.testing.assert_allclose(world.limits[:, 1], [np.pi, half, half, half], atol=1e-9)
    np.testing.assert_allclose(world.limits[:, 0], -world.limits[:, 1])
    np.testing.assert_allclose(world.max_speed, 5.0)


def test_markers_weigh_nothing_and_collide_with_nothing(world: World) -> None:
    model = world.model
    for name in AT_ZERO:
        geom = model.geom(f"marker_{name}").id
        assert model.geom_contype[geom] == 0
        assert model.geom_conaffinity[geom] == 0
    # links of 5, 3 and 1 kg; bodies without one count for nothing
    assert float(model.body_mass.sum()) == pytest.approx(9.0, abs=0.01)


def test_constant_setpoint_is_reached_without_steady_error(world: World) -> None:
    goal = np.array([1.0, 0.6, -0.8, 1.2])
    settle(world, goal, 3.0)
    np.testing.assert_allclose(world.angles(), goal, atol=1e-6)
    np.testing.assert_allclose(world.speeds(), 0.0, atol=1e-6)


def test_what_is_drawn_of_a_moving_arm_is_where_its_angles_put_it(world: World) -> None:
    speed = np.array([2.0, -1.0, 1.0, 1.5])
    setpoint = np.zeros(4)
    for _ in range(200):
        setpoint = setpoint + speed * world.step_s
        world.step(setpoint, speed)
        drawn = np.array(world.data.site("tip").xpos)
        np.testing.assert_allclose(drawn, tip(world.angles()), atol=1e-9)


def test_moving_setpoint_is_followed_without_lag(world: World) -> None:
    speed = np.array([2.0, -1.0, 1.0, 1.5])
    setpoint, errors = np.zeros(4), []
    for step in range(400):
        setpoint = setpoint + speed * world.step_s
        world.step(setpoint, speed)
        if step > 200:
            errors.append(np.abs(world.angles() - setpoint).max())
    # what is left are the centrifugal torques of all joints turning at once; a lag would be 100 mrad
    assert max(errors) < 0.01


@pytest.mark.parametrize(
    ("angles", "what"),
    [({"joint1": 4.0}, "joint1"), ({"joint3": float("nan")}, "finite"), ({"elbow": 0.0}, "elbow")],
)
def test_poses_that_are_none_are_refused_by_name(world: World, angles: dict[str, float], what: str) -> None:
    with pytest.raises(PoseError, match=what):
        world.pose(angles)


def test_rounding_beyond_a_limit_is_clamped(world: World) -> None:
    assert world.pose({"joint2": np.pi / 2 + 5e-7})[1] == world.limits[1, 1]
    with pytest.raises(PoseError):
        world.pose({"joint2": np.pi / 2 + 1e-4})


def test_longer_links_put_the_tip_farther_out_and_leave_the_described_arm_alone() -> None:
    described = load_model()
    before = described.body_pos.copy()
    longer = World(longer_links(described, 0.01), 1 / 30)
    q = np.array([0.4, 0.3, 0.7, -0.5])
    longer.reset(q)
    described_world = World(described, 1 / 30)
    described_world.reset(q)
    base = np.array([0.0, 0.0, 0.5])
    tip, described_tip = longer.data.site("tip").xpos, described_world.data.site("tip").xpos
    np.testing.assert_allclose(tip - base, 1.01 * (described_tip - base), atol=1e-12)
    for marker in ("green", "yellow", "blue", "red"):
        geom = f"marker_{marker}"
        np.testing.assert_allclose(
            longer.data.geom(geom).xpos - base, 1.01 * (described_world.data.geom(geom).xpos - base), atol=1e-12
        )
    np.testing.assert_array_equal(described.body_pos, before)
