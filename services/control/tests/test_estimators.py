import math
from collections.abc import Callable

import numpy as np
import pytest

from armsight_control.chain import Array
from armsight_control.estimators import ESTIMATORS, choose
from armsight_control.kinematics import directions
from armsight_control.trajectory import part1_motion, part2_motion

RATE_HZ = 30


def follow(name: str, path: Array, sigma: float = 0.0, seed: int = 1) -> tuple[Array, Array]:
    """Angles and observable flags along a path, starting from its first pose; noise on the directions in radians."""
    rng = np.random.default_rng(seed)
    step = ESTIMATORS[name].step
    state, angles, observable = path[0], [], []
    for q in path:
        r3, r4 = (r + rng.normal(0, sigma, 3) for r in directions(q))
        state, estimate = step(state, r3 / np.linalg.norm(r3), r4 / np.linalg.norm(r4))
        angles.append(estimate.angles)
        observable.append(estimate.observable)
    return np.array(angles), np.array(observable)


def sampled(motion: Callable[[float], Array], begin_s: float = 0.0, end_s: float = 60.0) -> Array:
    return np.array([motion(t) for t in np.arange(begin_s, end_s, 1 / RATE_HZ)])


def test_part_1_finds_the_angles_of_its_test_exactly() -> None:
    path = sampled(part1_motion)
    angles, observable = follow("part1", path)
    assert observable[:, 1:].all(), "psi is far from 0 whenever phi is at ±pi/2"
    assert not observable[:, 0].any(), "joint 1 is taken as fixed, not measured"
    assert np.abs(angles - path).max() < 1e-6


def test_part_2_finds_the_angles_of_its_test_exactly_where_they_are_observable() -> None:
    path = sampled(part2_motion)
    angles, observable = follow("part2", path)
    error = np.abs(angles - path)
    assert error[observable[:, 0]].max() < 1e-6
    assert observable[:, 0].mean() > 0.99, "theta is held only where the arm stands upright, at the start"
    assert not observable[:, 1].any()


@pytest.mark.parametrize(("name", "motion"), [("part1", part1_motion), ("part2", part2_motion)])
@pytest.mark.parametrize("sigma_m", [0.002, 0.005])
def test_noise_of_millimetres_leaves_less_than_10_mrad(
    name: str, motion: Callable[[float], Array], sigma_m: float
) -> None:
    path = sampled(motion)
    angles, observable = follow(name, path, sigma=sigma_m / 2.75)
    rms = [np.sqrt(np.mean((angles - path)[observable[:, i], i] ** 2)) for i in range(4) if observable[:, i].any()]
    assert max(rms) < 0.01, rms


@pytest.mark.parametrize("at_s", [14.0, 42.0])
def test_theta_touching_the_seam_does_not_switch_sets(at_s: float) -> None:
    path = sampled(part2_motion, at_s - 3, at_s + 3)
    assert np.abs(path[:, 0]).max() > math.pi - 1e-3
    for seed in range(5):
        angles, _ = follow("part2", path, sigma=2e-3, seed=seed)
        assert np.abs(angles - path).max() < 0.05, f"seed {seed}"
        assert np.abs(angles[:, 0]).max() <= math.pi, "what is published stays inside the limits"


def test_beyond_the_seams_margin_the_other_set_is_taken() -> None:
    # the wrong set was chosen at the start: the true angles are those of its twin
    true = np.array([[theta, 0.0, 0.8, 0.6] for theta in np.arange(-0.3, 0.3, 0.01)])
    state = np.array([math.pi - 0.3, 0.0, -0.8, -0.6])
    for q in true:
        state, estimate = ESTIMATORS["part2"].step(state, *directions(q))
    np.testing.assert_allclose(estimate.angles, true[-1], atol=1e-9)


def test_continuity_keeps_the_set_that_the_setpoint_settled() -> None:
    path = sampled(part2_motion, 5, 25)
    twin = path * [1, 1, -1, -1] - [math.pi, 0, 0, 0]
    twin = twin[twin[:, 0] > -math.pi]
    angles, observable = follow("part2", twin)
    assert np.abs(angles - twin)[observable[:, 0]].max() < 1e-6


@pytest.mark.parametrize("side", [-1, 1])
def test_part_1_measures_nu_by_the_right_hand_formula_at_phi_90_degrees(side: int) -> None:
    path = np.array([[0.0, nu, side * math.pi / 2, 0.9] for nu in np.linspace(-1.2, 1.2, 100)])
    angles, observable = follow("part1", path)
    assert observable[:, 1].all()
    assert np.abs(angles - path).max() < 1e-6


def test_part_1_holds_nu_in_gimbal_lock_and_says_so() -> None:
    # into the lock (phi = 90°, psi = 0) and turning nu inside it, which no camera can see
    into = [[0.0, 0.3, phi, 0.0] for phi in np.linspace(1.0, math.pi / 2, 40)]
    inside = [[0.0, nu, math.pi / 2, 0.0] for nu in np.linspace(0.3, 0.9, 40)]
    angles, observable = follow("part1", np.array(into + inside))
    assert not observable[40:, 1].any()
    np.testing.assert_allclose(angles[40:, 1], 0.3, atol=1e-9)
    np.testing.assert_allclose(angles[40:, 2:], [[math.pi / 2, 0.0]] * 40, atol=1e-6)


def test_part_2_holds_theta_in_gimbal_lock_and_says_so() -> None:
    into = [[1.2, 0.0, phi, 0.0] for phi in np.linspace(0.5, 0.0, 40)]
    inside = [[theta, 0.0, 0.0, 0.0] for theta in np.linspace(1.2, 2.0, 40)]
    angles, observable = follow("part2", np.array(into + inside))
    assert not observable[40:, 0].any()
    np.testing.assert_allclose(angles[40:, 0], 1.2, atol=1e-9)


def test_part_2_goes_through_phi_0_with_either_sign_of_psi() -> None:
    for psi in (-0.7, 0.7):
        path = np.array([[2.0, 0.0, phi, psi] for phi in np.linspace(0.4, -0.4, 120)])
        angles, observable = follow("part2", path)
        assert observable[:, 0].all()
        assert np.abs(angles - path).max() < 1e-6


def test_angles_that_do_not_explain_the_positions_are_not_called_observable() -> None:
    q = np.array([0.8, 0.7, 0.5, 0.6])
    for name in ("part1", "part2"):
        _, estimate = ESTIMATORS[name].step(q, *directions(q))
        assert not any(estimate.observable)
        assert estimate.misfit > 0.15


def test_the_estimator_is_the_one_whose_fixed_joint_is_at_0() -> None:
    assert choose(np.array([0.0, 0.5, 0.1, 0.1]), "part2").name == "part1"
    assert choose(np.array([0.5, 0.0, 0.1, 0.1]), "part1").name == "part2"
    assert choose(np.zeros(4), "part1").name == "part1"
    assert choose(np.zeros(4), "part2").name == "part2"
    assert choose(np.array([0.5, 0.5, 0.1, 0.1]), "part1").name == "part1"
