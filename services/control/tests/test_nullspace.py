import numpy as np
import pytest

from armsight_control.aiming import FREE_JOINTS, aim
from armsight_control.description import Arm
from armsight_control.kinematics import forward, jacobian
from armsight_control.nullspace import cost, damped_inverse, least_moved, null_motion, smallest_singular_value
from armsight_control.tracking import Moving

ALL = FREE_JOINTS["all"]


def test_away_from_singularities_the_damped_inverse_is_the_pseudo_inverse(arm: Arm, rng: np.random.Generator) -> None:
    for q in rng.uniform(-1, 1, (100, 4)) + np.array([0, 0, 0, 0.2]):
        by_joint = jacobian(arm.chain, q)
        if smallest_singular_value(by_joint) > 0.05:
            np.testing.assert_allclose(damped_inverse(by_joint), np.linalg.pinv(by_joint), atol=1e-9)


def test_in_a_singularity_the_damped_inverse_stays_small(arm: Arm) -> None:
    straight = jacobian(arm.chain, np.zeros(4))
    assert smallest_singular_value(straight) == pytest.approx(0.0, abs=1e-12)
    assert np.abs(damped_inverse(straight)).max() <= 1 / (2 * 0.05) + 1e-9
    assert np.abs(damped_inverse(np.zeros((3, 4)))).max() == 0.0


def test_null_motion_leaves_the_tip_where_it_is_and_lowers_the_cost(arm: Arm, rng: np.random.Generator) -> None:
    moved = 0
    for q in rng.uniform(arm.chain.limits[:, 0], arm.chain.limits[:, 1], (200, 4)):
        by_joint = jacobian(arm.chain, q)
        if smallest_singular_value(by_joint) < 0.1:
            continue
        speed = null_motion(arm.chain, q, by_joint, ALL)
        assert np.abs(speed).max() <= 0.3 + 1e-12
        h = 1e-4
        assert np.linalg.norm(forward(arm.chain, q + h * speed) - forward(arm.chain, q)) < 20 * h * h
        if np.abs(speed).max() > 1e-3:
            moved += 1
            assert cost(arm.chain, q + h * speed, ALL) < cost(arm.chain, q, ALL)
    assert moved > 50


def test_three_joints_leave_nothing_over(arm: Arm) -> None:
    q, free = np.array([0.3, 0.0, 0.6, 0.8]), FREE_JOINTS["3"]
    assert not null_motion(arm.chain, q, jacobian(arm.chain, q)[:, list(free)], free).any()


@pytest.mark.parametrize("free", ["3", "all"])
def test_an_aim_puts_the_tip_on_the_point_and_moves_with_it(free: str, arm: Arm, rng: np.random.Generator) -> None:
    chain, joints = arm.chain, FREE_JOINTS[free]
    for _ in range(50):
        q = np.array([rng.uniform(-2, 2), 0.0, rng.uniform(0.3, 1.2), rng.uniform(0.3, 1.2)])
        point = Moving(forward(chain, q + rng.normal(0, 0.02, 4) * [1, 0, 1, 1]), rng.uniform(-0.5, 0.5, 3))
        found = aim(chain, joints, point, q, 1 / 30)
        assert found.reachable
        np.testing.assert_allclose(found.tip, point.position, atol=1e-4)
        np.testing.assert_allclose(jacobian(chain, found.q) @ found.velocity, point.velocity, atol=0.03)
        assert np.abs(found.q - q).max() < 0.3


@pytest.mark.parametrize("free", ["3", "all"])
def test_an_aim_out_of_reach_says_so_and_stays_within_the_limits(free: str, arm: Arm) -> None:
    point = Moving(np.array([9.0, 1.0, 6.0]), np.zeros(3))
    q = np.array([1.3, 0.0, 1.0, 0.5])
    for _ in range(100):
        found = aim(arm.chain, FREE_JOINTS[free], point, q, 1 / 30)
        q = found.q
    assert not found.reachable
    assert (found.q == arm.chain.clip(found.q)).all()
    best = np.array([0, 0, 4]) + 6 * (point.position - [0, 0, 4]) / np.linalg.norm(point.position - [0, 0, 4])
    missed = np.linalg.norm(found.tip - point.position) - np.linalg.norm(best - point.position)
    assert missed < 0.01


@pytest.mark.parametrize("most_m", [0.5, 3.0])
def test_how_little_the_tip_moves_in_one_direction_is_told_up_to_what_is_asked_for(
    most_m: float, arm: Arm, rng: np.random.Generator
) -> None:
    for q in rng.uniform(arm.chain.limits[:, 0], arm.chain.limits[:, 1], size=(100, 4)):
        by_joint = jacobian(arm.chain, q)[:, [0, 2, 3]]
        least = np.linalg.svd(by_joint, compute_uv=False)[-1]
        columns = [(x, y, z) for x, y, z in by_joint.T.tolist()]
        assert least_moved(columns, most_m) == pytest.approx(min(most_m, least), abs=1e-12)
