import math

import numpy as np
import pytest
from scipy.optimize import least_squares

from armsight_control.chain import Array
from armsight_control.description import Arm
from armsight_control.errors import ControlError, SolverError
from armsight_control.kinematics import Links, forward, report_forward, report_jacobian
from armsight_control.solvers import Options, Problem, Status, closed_form, solve
from armsight_control.solvers.start import FIXED_RAD, start
from armsight_control.solvers.workspace import nearest_reachable

LINKS = Links(4.0, 3.2, 2.8)
LIMITS = np.array([[-math.pi, math.pi], [-math.pi / 2, math.pi / 2], [-math.pi / 2, math.pi / 2]])


def random_reachable(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    q = rng.uniform(LIMITS[:, 0], LIMITS[:, 1], size=(count, 3))
    return q, report_forward(LINKS, q)


def test_every_branch_of_the_closed_form_reaches_the_target_inside_the_limits(rng: np.random.Generator) -> None:
    configurations, targets = random_reachable(rng, 1000)
    for q, target in zip(configurations, targets, strict=True):
        branches = closed_form.branches(LINKS, target, 0.0)
        np.testing.assert_allclose(report_forward(LINKS, branches), np.tile(target, (4, 1)), atol=1e-9)
        assert (branches >= LIMITS[:, 0]).all()
        assert (branches <= LIMITS[:, 1]).all()
        off = np.abs(np.angle(np.exp(1j * (branches - q)))).max(axis=1)
        assert off.min() < 1e-6, "one of the branches is the configuration that the target came from"


def test_targets_of_the_arm_are_reachable(rng: np.random.Generator) -> None:
    for target in random_reachable(rng, 1000)[1]:
        point, reachable = nearest_reachable(LINKS, target, 0.0)
        assert reachable
        np.testing.assert_array_equal(point, target)


def test_the_nearest_reachable_point_is_never_beaten_by_least_squares(rng: np.random.Generator) -> None:
    targets = rng.uniform([-8, -8, -1], [8, 8, 12], size=(100, 3))
    for target in targets:
        point, reachable = nearest_reachable(LINKS, target, 0.0)
        distance = np.linalg.norm(point - target)
        assert reachable == (distance == 0)
        found = [
            least_squares(
                lambda q, target=target: report_forward(LINKS, q) - target,
                rng.uniform(LIMITS[:, 0], LIMITS[:, 1]),
                jac=lambda q: report_jacobian(LINKS, q),
                bounds=(LIMITS[:, 0], LIMITS[:, 1]),
            )
            for _ in range(6)
        ]
        best = min(np.linalg.norm(each.fun) for each in found)
        assert distance <= best + 1e-6
        again, still = nearest_reachable(LINKS, point, 0.0)
        assert still, "the nearest reachable point is reachable"
        np.testing.assert_allclose(again, point, atol=1e-9)


def test_a_target_on_the_axis_is_answered_on_the_side_where_the_arm_is() -> None:
    point, reachable = nearest_reachable(LINKS, np.array([0.0, 0.0, 6.0]), azimuth=2.0)
    assert not reachable
    assert math.atan2(point[1], point[0]) == pytest.approx(2.0)
    top, reachable = nearest_reachable(LINKS, np.array([0.0, 0.0, 10.0]), azimuth=2.0)
    assert reachable
    np.testing.assert_array_equal(top, [0, 0, 10.0])


@pytest.mark.parametrize("solver", ["closed-form", "gradient-descent"])
def test_a_target_out_of_reach_is_answered_with_the_nearest_point_and_says_so(solver: str, arm: Arm) -> None:
    target = np.array([6.0, 5.0, 8.0])
    problem = Problem(arm.chain, target, np.array([0.5, 0.0, -0.8, 0.6]), Options(max_steps=20_000))
    solution = solve(solver, problem)
    best, _ = nearest_reachable(LINKS, target, 0.0)
    assert solution.status == Status.OUT_OF_REACH
    assert np.linalg.norm(solution.tip - best) < 0.015
    assert solution.residual_m == pytest.approx(np.linalg.norm(solution.tip - target))
    np.testing.assert_allclose(forward(arm.chain, solution.q), solution.tip, atol=1e-12)


def test_the_closed_form_takes_the_branch_nearest_to_the_start(arm: Arm, rng: np.random.Generator) -> None:
    for q, target in zip(*random_reachable(rng, 200), strict=True):
        near = np.insert(arm.chain.clip(np.insert(q, 1, 0.0))[[0, 2, 3]] * 0.999, 1, 0.0)
        solution = solve("closed-form", Problem(arm.chain, target, near))
        assert solution.status == Status.CONVERGED
        assert solution.residual_m < 1e-9
        np.testing.assert_allclose(solution.q[[0, 2, 3]], q, atol=1e-6)


def test_autograds_gradient_is_minus_two_thirds_of_the_jacobian_times_the_error(rng: np.random.Generator) -> None:
    import torch

    from armsight_control.solvers import gradient_descent

    for q in rng.uniform(LIMITS[:, 0], LIMITS[:, 1], size=(100, 3)):
        target = rng.uniform(-6, 6, 3)
        slope, error = gradient_descent.gradient(LINKS, torch.tensor(q), torch.tensor(target))
        residual = target - report_forward(LINKS, q)
        np.testing.assert_allclose(slope.numpy(), -2 / 3 * report_jacobian(LINKS, q).T @ residual, atol=1e-6)
        assert error.item() == pytest.approx(np.abs(residual).mean())


def test_the_descent_is_the_reports_to_the_letter(rng: np.random.Generator) -> None:
    # the same in numpy with the hand-written gradient: q <- clamp(q + α ⅔ Jᵀ (target - K)), to MAE < 0.005 or 500 steps
    from armsight_control.solvers import gradient_descent

    options = Options()
    assert (options.alpha, options.tolerance_m, options.max_steps) == (0.01, 0.005, 500)
    met = 0
    for target in random_reachable(rng, 12)[1]:
        q = begin = rng.normal(0, 0.005, 3)
        steps = 0
        while steps < 500 and np.abs(target - report_forward(LINKS, q)).mean() >= 0.005:
            gradient = -2 / 3 * report_jacobian(LINKS, q).T @ (target - report_forward(LINKS, q))
            q = np.clip(q - 0.01 * gradient, LIMITS[:, 0], LIMITS[:, 1])
            steps += 1
        found, iterations, converged = gradient_descent.descend(LINKS, LIMITS, target, begin, options)
        np.testing.assert_allclose(found, q, atol=1e-9)
        assert iterations == steps
        assert converged == (np.abs(target - report_forward(LINKS, q)).mean() < 0.005)
        met += converged
    assert 0 < met < 12, "as published it meets its tolerance on some targets only"


def test_a_descent_stays_inside_the_limits(arm: Arm) -> None:
    problem = Problem(arm.chain, np.array([0.5, -5.0, 1.0]), np.array([3.1, 0.0, -1.5, 1.5]))
    solution = solve("gradient-descent", problem)
    assert (solution.q == arm.chain.clip(solution.q)).all()
    assert solution.q[1] == 0


def test_the_three_initialisations_start_where_they_say(arm: Arm, rng: np.random.Generator) -> None:
    previous = np.array([0.3, 0.4, -0.5, 0.6])
    np.testing.assert_array_equal(start(arm.chain, "fixed", previous, rng), [FIXED_RAD, 0, FIXED_RAD, FIXED_RAD])
    np.testing.assert_array_equal(start(arm.chain, "previous", previous, rng), [0.3, 0, -0.5, 0.6])
    drawn = np.array([start(arm.chain, "random", previous, rng) for _ in range(2000)])
    assert (drawn[:, 1] == 0).all()
    np.testing.assert_allclose(drawn[:, [0, 2, 3]].std(axis=0), 0.005, rtol=0.1)
    assert not (start(arm.chain, "previous", None, rng)[[0, 2, 3]] == 0).any(), "without one it draws"


def test_an_unknown_solver_and_options_that_cannot_work_are_refused(arm: Arm) -> None:
    with pytest.raises(SolverError, match="there are gradient-descent, closed-form"):
        solve("newton", Problem(arm.chain, np.zeros(3), np.zeros(4)))
    for options in ({"alpha": 0.0}, {"alpha": math.nan}, {"tolerance_m": -1.0}, {"max_steps": 0}):
        with pytest.raises(ControlError, match="not"):
            Options(**options)
