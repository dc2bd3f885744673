import numpy as np
import pytest
from scipy.optimize import minimize

from armsight.v1.description_pb2 import ArmDescription, LinkShape
from armsight.v1.geometry_pb2 import Vector3
from armsight_control.barrier import Capsule, allowed, capsules_of, clearances
from armsight_control.chain import Array, Point
from armsight_control.description import Arm
from armsight_control.kinematics import position
from armsight_control.tracking import Moving

CAPSULES = (
    Capsule(2, np.zeros(3), np.array([0, 0, 3.2]), 0.2),
    Capsule(3, np.zeros(3), np.array([0, 0, 2.8]), 0.1),
)
MOST = np.full(4, 1.5)


def brute_force(arm: Arm, q: Array, capsule: Capsule, point: Array) -> float:
    places = [
        position(arm.chain, q, Point(capsule.joint, capsule.start + share * (capsule.end - capsule.start)))
        for share in np.linspace(0, 1, 401)
    ]
    return float(np.linalg.norm(np.array(places) - point, axis=1).min()) - capsule.radius_m


def nearest_allowed(arm: Arm, q: Array, point: Moving, wanted: Array) -> Array:
    """By a general solver."""
    rows = clearances(arm.chain, q, CAPSULES, point.position)
    gradients = np.array([c.gradient for c in rows])
    least = np.array([c.away @ point.velocity - 2.0 * (c.distance_m - 0.9) for c in rows])
    best = minimize(
        lambda v: ((v - wanted) ** 2).sum(),
        wanted,
        bounds=[(-1.5, 1.5)] * 4,
        constraints={"type": "ineq", "fun": lambda v: gradients @ v - least},
    )
    assert best.success
    return np.asarray(best.x)


def test_clearances_are_those_of_the_nearest_points_and_their_gradients(arm: Arm, rng: np.random.Generator) -> None:
    for _ in range(6):
        q = rng.uniform(arm.chain.limits[:, 0], arm.chain.limits[:, 1])
        point = rng.uniform([-4, -4, 3], [4, 4, 9])
        for i, (found, capsule) in enumerate(zip(clearances(arm.chain, q, CAPSULES, point), CAPSULES, strict=True)):
            assert found.distance_m == pytest.approx(brute_force(arm, q, capsule, point), abs=5e-3)
            for joint in range(4):
                step = np.eye(4)[joint] * 1e-6
                up = clearances(arm.chain, q + step, CAPSULES, point)[i].distance_m
                down = clearances(arm.chain, q - step, CAPSULES, point)[i].distance_m
                assert found.gradient[joint] == pytest.approx((up - down) / 2e-6, abs=1e-4)


def test_allowed_speeds_are_the_nearest_that_keep_every_distance(arm: Arm, rng: np.random.Generator) -> None:
    slowed = 0
    for _ in range(40):
        q = rng.uniform([-2, -0.5, 0.2, 0.2], [2, 0.5, 1.2, 1.2])
        near = position(arm.chain, q, Point(3, np.array([0, 0, rng.uniform(0, 2.8)])))
        point = Moving(near + rng.normal(0, 0.8, 3), rng.uniform(-0.3, 0.3, 3))
        wanted = rng.uniform(-1, 1, 4)
        found = allowed(arm.chain, q, CAPSULES, point, 0.9, wanted, MOST)
        if not found.slowed:
            np.testing.assert_array_equal(found.velocity, wanted)
            continue
        slowed += 1
        if not found.found:
            continue
        assert (np.abs(found.velocity) <= MOST + 1e-9).all()
        best = nearest_allowed(arm, q, point, wanted)
        assert np.linalg.norm(found.velocity - wanted) <= np.linalg.norm(best - wanted) + 0.02
        for c in clearances(arm.chain, q, CAPSULES, point.position):
            assert c.gradient @ found.velocity - c.away @ point.velocity >= -2.0 * (c.distance_m - 0.9) - 2e-3
    assert slowed > 10


def test_a_demand_that_no_speed_meets_is_said(arm: Arm) -> None:
    q = np.array([0.3, 0.0, 0.8, 0.6])
    inside = position(arm.chain, q, Point(2, np.array([0, 0, 0.05])))
    found = allowed(arm.chain, q, CAPSULES, Moving(inside, np.zeros(3)), 0.9, np.zeros(4), MOST)
    assert not found.found


def test_links_that_move_in_space_are_taken_from_the_description(arm: Arm) -> None:
    message = ArmDescription(
        links=[
            LinkShape(name="base", start=Vector3(z=-0.5), end=Vector3(), radius_m=1.5),
            LinkShape(name="1", joint="joint1", start=Vector3(), end=Vector3(z=4), radius_m=0.35),
            LinkShape(name="4", joint="joint4", start=Vector3(), end=Vector3(z=2.8), radius_m=0.1),
        ]
    )
    (only,) = capsules_of(message, arm.chain)
    assert (only.joint, only.radius_m) == (3, 0.1)
    np.testing.assert_array_equal(only.end, [0, 0, 2.8])
