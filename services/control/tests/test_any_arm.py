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
from armsight_control.chain import Point
from armsight_control.description import Arm, arm_of
from armsight_control.errors import UnsupportedArmError
from armsight_control.kinematics import forward
from armsight_control.positions import shoulder_of, tip_line_of
from armsight_control.solvers import Problem, check_applies, solve, solve_batch
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
