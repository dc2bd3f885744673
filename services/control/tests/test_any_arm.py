"""An arm that is not the first: five joints about z, x, x, z and y, as sim describes its second example.

Its description lies here as JSON, made by `armsight describe`: control's tests need no MuJoCo.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from google.protobuf.json_format import ParseDict

from armsight.v1.description_pb2 import ArmDescription
from armsight_control.aiming import aim, free_of
from armsight_control.barrier import capsules_of
from armsight_control.chain import Array, Point
from armsight_control.description import Arm, arm_of
from armsight_control.errors import UnsupportedArmError
from armsight_control.kinematics import forward, jacobian
from armsight_control.positions import shoulder_of, tip_line_of
from armsight_control.solvers import Problem, Status, check_applies, edge, solve, solve_batch
from armsight_control.tracking import Moving
from armsight_control.trajectory import all_motion_of

FIVE = json.loads((Path(__file__).parent / "five.json").read_text(encoding="utf-8"))
SEED = 51377
"""Of targets; not used while anything was tuned."""


@pytest.fixture(scope="module")
def message() -> ArmDescription:
    return ParseDict(FIVE, ArmDescription())


@pytest.fixture(scope="module")
def arm(message: ArmDescription) -> Arm:
    return arm_of(message)


@pytest.mark.parametrize("solver", ["torch", "levenberg-marquardt"])
def test_solvers_reach_1000_random_targets(arm: Arm, solver: str) -> None:
    chain, rng = arm.chain, np.random.default_rng(SEED)
    aims = forward(chain, rng.uniform(chain.limits[:, 0], chain.limits[:, 1], (1000, chain.count)))
    starts = rng.uniform(chain.limits[:, 0], chain.limits[:, 1], (1000, chain.count))
    found = solve_batch(solver, chain, aims, starts, tuple(range(chain.count)))
    tips = forward(chain, found.q)
    assert (np.linalg.norm(tips - aims, axis=1) < 5e-3).mean() >= 0.999
    assert ((found.q >= chain.limits[:, 0]) & (found.q <= chain.limits[:, 1])).all()


@pytest.mark.parametrize("solver", ["torch", "levenberg-marquardt"])
@pytest.mark.parametrize("distance_m", [9.2, 12.0, 30.0])
def test_a_target_beyond_the_reach_is_said_to_be_and_answered_by_the_nearest_point(
    arm: Arm, solver: str, distance_m: float
) -> None:
    chain, rng = arm.chain, np.random.default_rng(90211)
    away = rng.normal(size=(40, 3))
    aims = distance_m * away / np.linalg.norm(away, axis=1, keepdims=True)
    starts = rng.uniform(chain.limits[:, 0], chain.limits[:, 1], (40, chain.count))
    found = solve_batch(solver, chain, aims, starts, tuple(range(chain.count)))
    assert set(found.status) == {Status.UNREACHABLE}
    assert found.converged.all()
    tips = forward(chain, rng.uniform(chain.limits[:, 0], chain.limits[:, 1], (200_000, chain.count)))
    nearest = [float(np.linalg.norm(tips - aim, axis=1).min()) for aim in aims]
    assert (found.residual_m <= nearest).all(), "nothing that was tried at random is nearer"


def test_the_edges_second_derivatives_are_those_of_the_distance(arm: Arm) -> None:
    chain, rng, h = arm.chain, np.random.default_rng(4), 1e-5
    q = rng.uniform(chain.limits[:, 0], chain.limits[:, 1])
    target = np.array([[7.0, -3.0, 9.0]])

    def gradient(at: Array) -> Array:
        return np.asarray(jacobian(chain, at).T @ (forward(chain, at) - target[0]))

    error, slope, curve = edge.derivatives(chain, target, q[None], list(range(chain.count)))
    assert error[0] == pytest.approx(np.linalg.norm(forward(chain, q) - target[0]))
    np.testing.assert_allclose(slope[0], gradient(q), atol=1e-12)
    numeric = [(gradient(q + h * step) - gradient(q - h * step)) / (2 * h) for step in np.eye(chain.count)]
    np.testing.assert_allclose(curve[0], numeric, atol=1e-6)


def test_the_edge_is_walked_to_within_the_limits_whichever_joints_are_free(arm: Arm) -> None:
    chain, rng, free = arm.chain, np.random.default_rng(12), (0, 1, 3)
    q = rng.uniform(chain.limits[:, 0], chain.limits[:, 1], (50, chain.count))
    targets = rng.normal(size=(50, 3)) * 12
    before = np.linalg.norm(forward(chain, q) - targets, axis=1)
    found = edge.nearest(chain, targets, q, free, 1e-4)
    assert found.stationary.mean() > 0.95
    assert (found.error_m <= before).all()
    np.testing.assert_allclose(found.error_m, np.linalg.norm(forward(chain, found.q) - targets, axis=1))
    assert ((found.q >= chain.limits[:, 0]) & (found.q <= chain.limits[:, 1])).all()
    assert (found.q[:, [2, 4]] == q[:, [2, 4]]).all()


@pytest.mark.parametrize("solver", ["closed-form", "gradient-descent"])
def test_solvers_of_the_reports_arm_refuse_it(arm: Arm, solver: str) -> None:
    problem = Problem(arm.chain, np.array([1.0, 1.0, 6.0]), np.zeros(5), (0, 2, 3))
    with pytest.raises(UnsupportedArmError, match=f"{solver} does not apply to this arm.*use torch"):
        solve(solver, problem)
    with pytest.raises(UnsupportedArmError, match="does not apply"):
        check_applies(solver, arm.chain)


@pytest.mark.parametrize("choice", ["3", "all"])
def test_an_aim_is_carried_on_with_all_joints(arm: Arm, choice: str) -> None:
    chain, rng = arm.chain, np.random.default_rng(SEED + 1)
    free = free_of(chain, choice)
    assert free == (0, 1, 2, 3, 4)
    for _ in range(20):
        q = rng.uniform(0.6 * chain.limits[:, 0], 0.6 * chain.limits[:, 1])
        point = Moving(forward(chain, q) + rng.normal(0, 0.01, 3), rng.normal(0, 0.1, 3))
        found = aim(chain, free, point, q, 1 / 30)
        assert found.reachable
        assert np.linalg.norm(forward(chain, found.q) - point.position) < 1e-3


def test_tip_is_on_the_line_through_the_markers_of_its_link(arm: Arm) -> None:
    line = tip_line_of(arm)
    assert line is not None
    assert line.along == pytest.approx({"azure": 0.1, "violet": 0.95, "rose": 1.7})
    assert line.tip == pytest.approx(1.6)


def test_that_line_need_not_run_through_the_joint(arm: Arm) -> None:
    beside = np.array([0.3, -0.2, 0.0])
    chain = replace(arm.chain, tip=Point(4, arm.chain.tip.position + beside))
    markers = {n: Point(p.joint, p.position + beside * (p.joint == 4)) for n, p in arm.markers.items()}
    line = tip_line_of(replace(arm, chain=chain, markers=markers))
    assert line is not None
    assert set(line.along) == {"azure", "violet", "rose"}
    assert line.along["rose"] - line.tip == pytest.approx(0.1)
    off = {name: point for name, point in markers.items() if name not in ("azure", "violet")}
    assert tip_line_of(replace(arm, chain=chain, markers=off)) is None


def test_what_does_not_move_is_found(arm: Arm, message: ArmDescription) -> None:
    np.testing.assert_allclose(shoulder_of(arm.chain), (0, 0, 3.2))
    assert [capsule.joint for capsule in capsules_of(message, arm.chain)] == [1, 2, 3, 3, 4]
    assert arm.chain.scale == pytest.approx(0.88)


def test_motion_of_all_joints_stays_within_the_limits_and_reaches_them(arm: Arm) -> None:
    path = all_motion_of(arm.chain.limits)
    ways = np.array([path(t) for t in np.arange(0.0, 600.0, 0.05)])
    lower, upper = arm.chain.limits.T
    assert ((ways >= lower) & (ways <= upper)).all()
    np.testing.assert_allclose(ways.min(axis=0), lower, atol=1e-2)
    np.testing.assert_allclose(ways.max(axis=0), upper, atol=1e-2)
