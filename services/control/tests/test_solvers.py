import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import least_squares, minimize

from armsight_control.chain import Array, Chain, Point
from armsight_control.description import Arm
from armsight_control.errors import ControlError, SolverError, UnsupportedArmError
from armsight_control.folded import fold
from armsight_control.kinematics import Links, forward, jacobian, report_forward, report_jacobian
from armsight_control.solvers import (
    REPORT_FREE,
    ClosedFormOptions,
    GradientDescentOptions,
    LevenbergMarquardtOptions,
    Options,
    Problem,
    Status,
    TorchOptions,
    closed_form,
    gradient_descent,
    solve,
    solve_batch,
)
from armsight_control.solvers.blocks import DAMPED_STEPS, DESCENT_STEPS, Damped, Descent
from armsight_control.solvers.start import FIXED_RAD, start
from armsight_control.solvers.workspace import Moving, nearest_reachable, reaches

LINKS = Links(4.0, 3.2, 2.8)
LIMITS = np.array([[-math.pi, math.pi], [-math.pi / 2, math.pi / 2], [-math.pi / 2, math.pi / 2]])
ALL = (0, 1, 2, 3)
REACHED_M = {"torch": 0.005, "levenberg-marquardt": 1e-6, "closed-form": 1e-9}
BOTH = pytest.mark.parametrize("free", [REPORT_FREE, ALL], ids=["three joints", "four joints"])
EXACT = pytest.mark.parametrize("solver", sorted(REACHED_M))


def random_reachable(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    q = rng.uniform(LIMITS[:, 0], LIMITS[:, 1], size=(count, 3))
    return q, report_forward(LINKS, q)


def random_configurations(rng: np.random.Generator, chain: Chain, free: tuple[int, ...], count: int) -> Array:
    q = np.zeros((count, chain.count))
    q[:, free] = rng.uniform(chain.limits[:, 0], chain.limits[:, 1], size=(count, chain.count))[:, free]
    return q


def random_chain(rng: np.random.Generator, count: int) -> Chain:
    axes = rng.normal(size=(count, 3))
    return Chain(
        names=tuple(f"j{i}" for i in range(count)),
        origins=rng.normal(size=(count, 3)),
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        limits=np.tile([-1.5, 2.0], (count, 1)),
        max_speed=np.ones(count),
        tip=Point(count - 1, rng.normal(size=3)),
    )


# --- every solver


@EXACT
@BOTH
def test_every_target_that_the_arm_can_reach_is_reached_inside_the_limits(
    solver: str, free: tuple[int, ...], arm: Arm, rng: np.random.Generator
) -> None:
    targets = forward(arm.chain, random_configurations(rng, arm.chain, free, 300))
    starts = random_configurations(rng, arm.chain, free, 300)
    solutions = solve_batch(solver, arm.chain, targets, starts, free)
    assert solutions.converged.all()
    assert set(solutions.status) == {Status.CONVERGED}
    distance = np.linalg.norm(forward(arm.chain, solutions.q) - targets, axis=1)
    assert distance.max() < REACHED_M[solver]
    assert np.quantile(distance, 0.98) < 1e-5, "but where a limit stands in the way of the last steps"
    np.testing.assert_allclose(solutions.residual_m, distance, atol=1e-12)
    assert (solutions.q >= arm.chain.limits[:, 0]).all()
    assert (solutions.q <= arm.chain.limits[:, 1]).all()
    if free == REPORT_FREE:
        assert (solutions.q[:, 1] == 0).all()


@EXACT
@BOTH
def test_one_target_is_answered_as_it_is_in_a_batch_and_always_the_same(
    solver: str, free: tuple[int, ...], arm: Arm, rng: np.random.Generator
) -> None:
    targets = forward(arm.chain, random_configurations(rng, arm.chain, free, 4))
    starts = random_configurations(rng, arm.chain, free, 4)
    batch = solve_batch(solver, arm.chain, targets, starts, free)
    again = solve_batch(solver, arm.chain, targets, starts, free)
    np.testing.assert_array_equal(batch.q, again.q)
    for i, (target, begin) in enumerate(zip(targets, starts, strict=True)):
        alone = solve(solver, Problem(arm.chain, target, begin, free))
        assert alone.status == batch.status[i]
        assert alone.residual_m < REACHED_M[solver]
        if solver == "closed-form":
            np.testing.assert_allclose(alone.q, batch.q[i], atol=1e-9)


@pytest.mark.parametrize("solver", ["closed-form", "gradient-descent", "levenberg-marquardt", "torch"])
@BOTH
def test_a_target_out_of_reach_is_answered_with_the_nearest_point_and_its_distance(
    solver: str, free: tuple[int, ...], arm: Arm
) -> None:
    if solver == "gradient-descent" and free == ALL:
        with pytest.raises(SolverError, match="needs joint 2 at 0"):
            solve(solver, Problem(arm.chain, np.array([6.0, 5.0, 8.0]), np.zeros(4), free))
        return
    target = np.array([6.0, 5.0, 8.0])
    options = Options(gradient_descent=GradientDescentOptions(max_steps=20_000))
    solution = solve(solver, Problem(arm.chain, target, np.array([0.5, 0.0, -0.8, 0.6]), free, options))
    best, _ = nearest_reachable(LINKS, target, 0.0)
    assert solution.status == Status.UNREACHABLE
    assert solution.converged
    assert np.linalg.norm(solution.tip - best) < 0.015
    assert solution.residual_m == pytest.approx(np.linalg.norm(solution.tip - target))
    assert solution.residual_m == pytest.approx(np.linalg.norm(best - target), abs=0.015)
    np.testing.assert_allclose(forward(arm.chain, solution.q), solution.tip, atol=1e-12)


def path_through_the_edge(count: int) -> Array:
    # the exercise's own target, which leaves the reach and comes back
    t = np.linspace(0, 20, count)
    circle = [3 * np.cos(math.pi * t / 20), 4 * np.sin(math.pi * t / 14) + 0.5, np.sin(math.pi * t / 18) + 4.5]
    return np.stack(circle, axis=1)


def followed(solver: str, chain: Chain, free: tuple[int, ...], path: Array) -> tuple[Array, list[Status]]:
    q = np.array([0.3, 0.0, -0.9, 0.9])
    visited, status = [], []
    for target in path:
        solution = solve(solver, Problem(chain, target, q, free))
        q = solution.q
        visited.append(q)
        status.append(solution.status)
    return np.array(visited), status


@pytest.mark.parametrize("solver", ["levenberg-marquardt", "torch"])
@BOTH
def test_along_a_path_that_leaves_the_reach_and_returns_no_step_is_larger_than_the_exact_answers(
    solver: str, free: tuple[int, ...], arm: Arm
) -> None:
    path = path_through_the_edge(240)
    exact, status = followed("closed-form", arm.chain, free, path)
    assert {Status.CONVERGED, Status.UNREACHABLE} == set(status), "the path does both"
    found, found_status = followed(solver, arm.chain, free, path)
    assert found_status == status
    # the first step is from the start to the path
    largest, own = (np.abs(np.diff(q, axis=0)).max() for q in (found, exact))
    # near psi = 0 a thousandth of a radian is a micrometre at the tip
    assert largest <= own + 0.02
    off = np.linalg.norm(forward(arm.chain, found) - forward(arm.chain, exact), axis=1)
    assert off.max() < 0.005


@EXACT
def test_a_followed_target_stays_on_the_branch_of_the_start(solver: str, arm: Arm, rng: np.random.Generator) -> None:
    limits = 0.8 * arm.chain.limits
    for free in (REPORT_FREE, ALL):
        q = np.zeros((100, 4))
        q[:, free] = rng.uniform(limits[:, 0], limits[:, 1], size=(100, 4))[:, free]
        # away from where branches meet
        q[:, 2:] = np.sign(q[:, 2:]) * np.maximum(np.abs(q[:, 2:]), 0.4)
        moved = q.copy()
        moved[:, free] += rng.uniform(-0.02, 0.02, size=(100, 4))[:, free]
        solutions = solve_batch(solver, arm.chain, forward(arm.chain, moved), q, free)
        assert np.abs(solutions.q - q).max() < 0.25


@pytest.mark.parametrize("solver", ["levenberg-marquardt", "torch"])
def test_any_chain_is_solved_and_what_it_cannot_reach_is_as_near_as_least_squares_comes(
    solver: str, rng: np.random.Generator
) -> None:
    for count in (2, 6):
        chain = random_chain(rng, count)
        free = tuple(range(count))
        q = rng.uniform(chain.limits[:, 0], chain.limits[:, 1], size=(20, count))
        starts = rng.uniform(chain.limits[:, 0], chain.limits[:, 1], size=(20, count))
        solutions = solve_batch(solver, chain, forward(chain, q), starts, free)
        assert set(solutions.status) == {Status.CONVERGED}
        assert solutions.residual_m.max() < 0.005
        far = solve_batch(solver, chain, np.array([[30.0, 5.0, -8.0]]), starts[:1], free)
        best = min(
            least_squares(
                lambda each, chain=chain: forward(chain, each) - [30.0, 5.0, -8.0],
                rng.uniform(chain.limits[:, 0], chain.limits[:, 1]),
                jac=lambda each, chain=chain: jacobian(chain, each),
                bounds=(chain.limits[:, 0], chain.limits[:, 1]),
            ).cost
            for _ in range(12)
        )
        assert far.status[0] == Status.UNREACHABLE
        assert far.residual_m[0] == pytest.approx(math.sqrt(2 * best), rel=1e-4)


@pytest.mark.parametrize("solver", ["levenberg-marquardt", "torch"])
def test_joints_that_are_not_free_stay_where_the_start_has_them_each_target_its_own(
    solver: str, arm: Arm, rng: np.random.Generator
) -> None:
    free = (0, 2, 3)
    q = random_configurations(rng, arm.chain, ALL, 12)
    q[:, 1] = np.tile([0.3, -0.2, 0.0], 4)
    starts = random_configurations(rng, arm.chain, ALL, 12)
    starts[:, 1] = q[:, 1]
    targets = forward(arm.chain, q)
    solutions = solve_batch(solver, arm.chain, targets, starts, free)
    np.testing.assert_array_equal(solutions.q[:, 1], q[:, 1])
    assert solutions.residual_m.max() < 0.005
    np.testing.assert_allclose(forward(arm.chain, solutions.q), targets, atol=0.005)


# --- the closed forms


def test_every_branch_of_the_closed_form_reaches_the_target_inside_the_limits(rng: np.random.Generator) -> None:
    configurations, targets = random_reachable(rng, 1000)
    for q, target in zip(configurations, targets, strict=True):
        found = closed_form.branches(LINKS, target.tolist(), 0.0)
        branches = np.array(found)
        np.testing.assert_allclose(report_forward(LINKS, branches), np.tile(target, (4, 1)), atol=1e-9)
        assert closed_form.within_limits(found, LIMITS.tolist()) == found
        off = np.abs(np.angle(np.exp(1j * (branches - q)))).max(axis=1)
        assert off.min() < 1e-6, "one of the branches is the configuration that the target came from"


def test_the_filters_keep_what_is_within_the_limits_and_take_what_is_nearest() -> None:
    solutions = [(0.0, 0.5, 0.5), (1.0, -0.5, 0.5), (2.0, 0.5, -0.5)]
    assert closed_form.within_limits(solutions, [[-1.5, 1.5], [-1, 1], [-1, 1]]) == solutions[:2]
    assert closed_form.nearest_to(solutions, [1.8, 0.0, 0.0]) == solutions[2]
    with pytest.raises(ValueError, match="empty"):
        closed_form.nearest_to([], [0.0, 0.0, 0.0])


def test_the_closed_form_takes_the_branch_nearest_to_the_start(arm: Arm, rng: np.random.Generator) -> None:
    for q, target in zip(*random_reachable(rng, 200), strict=True):
        near = np.insert(arm.chain.clip(np.insert(q, 1, 0.0))[[0, 2, 3]] * 0.999, 1, 0.0)
        solution = solve("closed-form", Problem(arm.chain, target, near, REPORT_FREE))
        assert solution.status == Status.CONVERGED
        assert solution.residual_m < 1e-9
        np.testing.assert_allclose(solution.q[[0, 2, 3]], q, atol=1e-6)


def test_with_four_joints_the_closed_form_is_never_beaten_in_motion(arm: Arm, rng: np.random.Generator) -> None:
    chain = arm.chain
    q, starts = (random_configurations(rng, chain, ALL, 12) for _ in range(2))
    targets = forward(chain, q)
    solutions = solve_batch("closed-form", chain, targets, starts, ALL)
    motions = np.linalg.norm(solutions.q - starts, axis=1)
    assert (motions <= np.linalg.norm(q - starts, axis=1) + 1e-9).all(), "where the target came from is one solution"
    for target, begin, motion in zip(targets, starts, motions, strict=True):
        for _ in range(8):
            other = minimize(
                lambda each, begin=begin: ((each - begin) ** 2).sum(),
                rng.uniform(chain.limits[:, 0], chain.limits[:, 1]),
                jac=lambda each, begin=begin: 2 * (each - begin),
                bounds=chain.limits,
                constraints={
                    "type": "eq",
                    "fun": lambda each, target=target: forward(chain, each) - target,
                    "jac": lambda each: jacobian(chain, each),
                },
                options={"ftol": 1e-12},
            )
            if np.linalg.norm(forward(chain, other.x) - target) < 1e-6:
                assert motion <= math.sqrt(other.fun) + 1e-4


def test_with_four_joints_equal_motions_are_told_apart_by_the_distance_from_the_limits(arm: Arm) -> None:
    # stretched forwards at shoulder height, joint 3 turned by a quarter: up and down cost the same motion
    solution = solve("closed-form", Problem(arm.chain, np.array([0.0, 0.0, 9.0]), np.zeros(4), ALL))
    twin = np.array([solution.q[0], *-solution.q[1:]])
    assert np.linalg.norm(forward(arm.chain, solution.q) - [0, 0, 9]) < 1e-9
    assert np.linalg.norm(twin) == pytest.approx(np.linalg.norm(solution.q)), "its mirror image is as far"
    again = solve("closed-form", Problem(arm.chain, np.array([0.0, 0.0, 9.0]), solution.q, ALL))
    np.testing.assert_allclose(again.q, solution.q, atol=1e-6)


# --- the reach


@pytest.mark.parametrize("moving", ["joint 2 at 0", "all four"])
def test_no_configuration_puts_the_tip_outside_of_the_known_reach(
    moving: Moving, arm: Arm, rng: np.random.Generator
) -> None:
    free = ALL if moving == "all four" else REPORT_FREE
    q = random_configurations(rng, arm.chain, free, 20_000)
    # a third of them with joints at their limits, where the region has its edges
    at_limit = rng.random(q.shape) < 0.3
    q[at_limit] = (np.sign(q) * arm.chain.limits[:, 1])[at_limit]
    tips = forward(arm.chain, q)
    for tip in tips[~reaches(LINKS, np.hypot(tips[:, 0], tips[:, 1]), tips[:, 2] - LINKS.l1, moving)]:
        point, _ = nearest_reachable(LINKS, tip, 0.0, moving)
        np.testing.assert_allclose(point, tip, atol=1e-9)


@pytest.mark.parametrize("moving", ["joint 2 at 0", "all four"])
def test_the_nearest_reachable_point_is_never_beaten_by_least_squares_and_can_be_reached(
    moving: Moving, arm: Arm, rng: np.random.Generator
) -> None:
    free = list(ALL if moving == "all four" else REPORT_FREE)
    limits = arm.chain.limits[free]

    def tip(q: Array) -> Array:
        full = np.zeros(4)
        full[free] = q
        return forward(arm.chain, full)

    def slope(q: Array) -> Array:
        full = np.zeros(4)
        full[free] = q
        return np.asarray(jacobian(arm.chain, full)[:, free])

    for target in rng.uniform([-8, -8, -2], [8, 8, 12], size=(60, 3)):
        point, reachable = nearest_reachable(LINKS, target, 0.0, moving)
        distance = np.linalg.norm(point - target)
        assert reachable == (distance == 0)
        found = [
            least_squares(
                lambda q, target=target: tip(q) - target,
                rng.uniform(limits[:, 0], limits[:, 1]),
                jac=slope,
                bounds=(limits[:, 0], limits[:, 1]),
            )
            for _ in range(6)
        ]
        best = min(np.linalg.norm(each.fun) for each in found)
        assert distance <= best + 1e-6
        exact = solve("closed-form", Problem(arm.chain, point, np.zeros(4), tuple(free)))
        np.testing.assert_allclose(exact.tip, point, atol=1e-8)


def test_targets_of_the_arm_are_reachable(rng: np.random.Generator) -> None:
    for target in random_reachable(rng, 1000)[1]:
        point, reachable = nearest_reachable(LINKS, target, 0.0)
        assert reachable
        np.testing.assert_array_equal(point, target)


def test_a_target_on_the_axis_is_answered_on_the_side_where_the_arm_is() -> None:
    point, reachable = nearest_reachable(LINKS, np.array([0.0, 0.0, 6.0]), azimuth=2.0)
    assert not reachable
    assert math.atan2(point[1], point[0]) == pytest.approx(2.0)
    top, reachable = nearest_reachable(LINKS, np.array([0.0, 0.0, 10.0]), azimuth=2.0)
    assert reachable
    np.testing.assert_array_equal(top, [0, 0, 10.0])


# --- the blocks that are compiled


def test_a_descent_block_is_projected_gradient_descent_with_momentum(rng: np.random.Generator) -> None:
    chain = random_chain(rng, 5)
    free = (0, 2, 3, 4)
    folded = fold(chain, free, (0.4,))
    q = np.insert(rng.uniform(-1.5, 2.0, size=(7, 4)), 1, 0.4, axis=1)
    aims = forward(chain, np.insert(rng.uniform(-1.5, 2.0, size=(7, 4)), 1, 0.4, axis=1))
    aims[0] = forward(chain, q[0]) + 1e-6
    steps, beta = np.array([0.01, 0.02, 0.03, 0.04]), 0.8
    expected, speeds = q.copy(), np.zeros((7, 4))
    for _ in range(DESCENT_STEPS):
        for k in range(7):
            error = forward(chain, expected[k]) - aims[k]
            if error @ error <= 1e-4**2:
                continue
            gradient = jacobian(chain, expected[k])[:, free].T @ error
            moved = expected[k].copy()
            moved[list(free)] += beta * speeds[k] - steps * gradient
            speeds[k], expected[k] = (chain.clip(moved) - expected[k])[list(free)], chain.clip(moved)
    u, v, _ = Descent()(
        torch.tensor((q[:, free] + folded.offsets).T),
        torch.zeros(4, 7, dtype=torch.float64),
        torch.tensor(folded.to_first(aims).T),
        torch.tensor(folded.links),
        torch.tensor(np.column_stack([folded.limits, steps])),
        torch.tensor([beta, 1e-4**2], dtype=torch.float64),
    )
    np.testing.assert_allclose(u.numpy().T - folded.offsets, expected[:, free], atol=1e-12)
    np.testing.assert_allclose(v.numpy().T, speeds, atol=1e-12)
    np.testing.assert_array_equal(expected[0], q[0])


def test_a_damped_block_takes_the_steps_of_levenberg_marquardt_within_the_limits(rng: np.random.Generator) -> None:
    chain = random_chain(rng, 4)
    folded = fold(chain, ALL, ())
    q = rng.uniform(-1.5, 2.0, size=(40, 4))
    q[rng.random(q.shape) < 0.2] = 2.0
    aims = forward(chain, rng.uniform(-1.5, 2.0, size=(40, 4)))
    expected = []
    for begin, aim in zip(q, aims, strict=True):
        at, damping = begin, 0.01
        for _ in range(DAMPED_STEPS):
            error, slope = aim - forward(chain, at), jacobian(chain, at)
            step = np.linalg.solve(slope.T @ slope + damping * np.eye(4), slope.T @ error)
            inside = ~((at <= chain.limits[:, 0]) & (step < 0) | (at >= chain.limits[:, 1]) & (step > 0))
            slope = slope * inside
            step = np.linalg.solve(slope.T @ slope + damping * np.eye(4), slope.T @ error)
            tried = chain.clip(at + step)
            nearer = np.linalg.norm(forward(chain, tried) - aim) < np.linalg.norm(error)
            at, damping = (tried, damping * 0.2) if nearer else (at, damping * 4)
        expected.append(at)
    u, _, squared, slope2 = Damped()(
        torch.tensor((q + folded.offsets).T),
        torch.full((40,), 0.01, dtype=torch.float64),
        torch.tensor(folded.to_first(aims).T),
        torch.tensor(folded.links),
        torch.tensor(folded.limits),
        torch.tensor([1e-30], dtype=torch.float64),
    )
    found = u.numpy().T - folded.offsets
    np.testing.assert_allclose(found, expected, atol=1e-7)
    np.testing.assert_allclose(squared.numpy(), ((forward(chain, found) - aims) ** 2).sum(axis=1), atol=1e-9)
    for each, aim, found2 in zip(found, aims, slope2.numpy(), strict=True):
        gradient = jacobian(chain, each).T @ (forward(chain, each) - aim)
        stuck = (each <= chain.limits[:, 0] + 1e-12) & (gradient > 0)
        stuck |= (each >= chain.limits[:, 1] - 1e-12) & (gradient < 0)
        assert found2 == pytest.approx((gradient[~stuck] ** 2).sum(), rel=1e-6, abs=1e-12)


# --- the report's descent


def test_autograds_gradient_is_minus_two_thirds_of_the_jacobian_times_the_error(rng: np.random.Generator) -> None:
    for q in rng.uniform(LIMITS[:, 0], LIMITS[:, 1], size=(100, 3)):
        target = rng.uniform(-6, 6, 3)
        slope, error = gradient_descent.gradient(LINKS, torch.tensor(q), torch.tensor(target))
        residual = target - report_forward(LINKS, q)
        np.testing.assert_allclose(slope.numpy(), -2 / 3 * report_jacobian(LINKS, q).T @ residual, atol=1e-6)
        assert error.item() == pytest.approx(np.abs(residual).mean())


def test_the_descent_is_the_reports_to_the_letter(rng: np.random.Generator) -> None:
    # the same in numpy with the hand-written gradient: q <- clamp(q + α ⅔ Jᵀ (target - K)), to MAE < 0.005 or 500 steps
    options = GradientDescentOptions()
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
    problem = Problem(arm.chain, np.array([0.5, -5.0, 1.0]), np.array([3.1, 0.0, -1.5, 1.5]), REPORT_FREE)
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


# --- what is refused


def test_what_cannot_be_solved_is_refused_with_what_is_wrong(arm: Arm, rng: np.random.Generator) -> None:
    chain, zeros = arm.chain, np.zeros(4)
    with pytest.raises(SolverError, match="there are torch, gradient-descent, levenberg-marquardt, closed-form"):
        solve("newton", Problem(chain, np.zeros(3), zeros, ALL))
    for free, text in (((), "none"), ((0, 0), "twice"), ((0, 4), "index 4; expected some of 0 to 3"), ((-1,), "-1")):
        with pytest.raises(SolverError, match=text):
            solve("closed-form", Problem(chain, np.zeros(3), zeros, free))
    with pytest.raises(SolverError, match="target 1 or its start is not finite"):
        solve_batch("closed-form", chain, np.array([[1.0, 2, 3], [math.nan, 0, 0]]), np.zeros((2, 4)), ALL)
    with pytest.raises(SolverError, match=r"expected \(2, 4\)"):
        solve_batch("closed-form", chain, np.zeros((2, 3)), np.zeros((2, 3)), ALL)
    with pytest.raises(SolverError, match="joint 2 at 0 or free"):
        solve("closed-form", Problem(chain, np.zeros(3), np.array([0, 0.1, 0, 0]), REPORT_FREE))
    with pytest.raises(UnsupportedArmError, match="about z, y, x and y"):
        solve("closed-form", Problem(random_chain(rng, 4), np.zeros(3), zeros, ALL))


def test_options_that_cannot_work_are_refused() -> None:
    wrong: dict[type, list[dict[str, float]]] = {
        GradientDescentOptions: [{"alpha": 0.0}, {"alpha": math.nan}, {"tolerance_m": -1.0}, {"max_steps": 0}],
        TorchOptions: [{"starts": 0}, {"momentum": 1.0}, {"step": 0.0}, {"descent_m": 1e-9}, {"max_steps": 0}],
        LevenbergMarquardtOptions: [{"tolerance_m": 0.0}, {"damping": -1.0}, {"restarts": -1}],
        ClosedFormOptions: [{"samples": 1}, {"tie_rad": 0.0}],
    }
    for options, values in wrong.items():
        for each in values:
            with pytest.raises(ControlError, match="not"):
                replace(options(), **each)
