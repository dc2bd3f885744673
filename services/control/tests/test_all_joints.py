"""The estimator of all joints, against positions by forward kinematics with noise drawn from their covariances."""

import math
from collections.abc import Callable, Mapping

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from armsight_control.chain import Array, Chain, Point
from armsight_control.description import Arm
from armsight_control.errors import PositionsError
from armsight_control.estimators import AllJoints, Outcome, kalman
from armsight_control.estimators.candidates import Candidates
from armsight_control.estimators.gauss_newton import Belief, fit, readings_of
from armsight_control.estimators.marker_model import MarkerModel
from armsight_control.kinematics import position
from armsight_control.positions import Positions, SeenMarker
from armsight_control.trajectory import all_motion, part1_motion, part2_motion

RATE_HZ = 30
MOTIONS = {"part1": part1_motion, "part2": part2_motion, "all": all_motion}
# What vision says of a sphere that it sees well: 3 mm across the view, more along the rays.
SHARP = np.diag([0.003, 0.003, 0.004]) ** 2
VAGUE = np.diag([0.15, 0.004, 0.004]) ** 2


def sampled(motion: Callable[[float], Array], begin_s: float, seconds: float) -> Array:
    return np.array([motion(begin_s + k / RATE_HZ) for k in range(int(seconds * RATE_HZ))])


class Cameras:
    """Positions with errors drawn from their covariances, alike from frame to frame by ``alike``."""

    def __init__(self, arm: Arm, seed: int, sigmas: float = 1.0, alike: float = 1 / 3) -> None:
        self.arm, self.sigmas, self.alike = arm, sigmas, alike
        self.rng = np.random.default_rng(seed)
        self.error = {name: self.rng.normal(0, 1, 3) for name in arm.markers}

    def look(self, q: Array, k: int, covariances: Mapping[str, Array | None] | None = None) -> Positions:
        """A covariance of None is a marker that is lost."""
        seen = {}
        for name, point in self.arm.markers.items():
            fresh = self.rng.normal(0, 1, 3)
            self.error[name] = self.alike * self.error[name] + math.sqrt(1 - self.alike**2) * fresh
            covariance = (covariances or {}).get(name, SHARP)
            if covariance is not None:
                off = self.sigmas * np.linalg.cholesky(covariance) @ self.error[name]
                seen[name] = SeenMarker(position(self.arm.chain, q, point) + off, covariance, False)
        return Positions(1_700_000_000_000_000_000 + k * 1_000_000_000 // RATE_HZ, seen)


def follow(
    arm: Arm,
    path: Array,
    cameras: Cameras,
    hidden: Callable[[int], Mapping[str, Array | None]] = lambda _: {},
    setpoints: Array | None = None,
) -> list[Outcome]:
    """Runs along a path, the setpoint one frame ahead of the arm, as sim does it."""
    estimator, track, outcomes = AllJoints(arm), None, []
    commanded = np.vstack([path[:1], path[:-1]]) if setpoints is None else setpoints
    for k, (q, setpoint) in enumerate(zip(path, commanded, strict=True)):
        outcome = estimator.step(track, cameras.look(q, k, hidden(k)), setpoint)
        track = outcome.track
        outcomes.append(outcome)
    return outcomes


def angles(outcomes: list[Outcome]) -> Array:
    return np.array([outcome.estimate.angles for outcome in outcomes])


def sigmas(outcomes: list[Outcome]) -> Array:
    return np.array([outcome.estimate.sigma for outcome in outcomes])


def observable(outcomes: list[Outcome]) -> Array:
    return np.array([outcome.estimate.observable for outcome in outcomes])


def other_arm(seed: int) -> Arm:
    """Five joints about random axes, a marker on every second link."""
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(5, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    names = tuple(f"j{i}" for i in range(5))
    limits = np.tile([-1.5, 1.5], (5, 1))
    chain = Chain(names, rng.normal(0, 1, (5, 3)), axes, limits, np.full(5, 5.0), Point(4, rng.normal(0, 1, 3)))
    markers = {f"m{i}": Point(i, rng.normal(0, 0.7, 3)) for i in (1, 2, 3, 4)} | {"m5": Point(4, rng.normal(0, 1, 3))}
    return Arm("other", chain, markers, np.eye(3), np.zeros(3))


@pytest.mark.parametrize("late", [0, 1, 2])
def test_a_pose_that_is_set_counts_from_its_first_frame_whenever_the_setpoint_tells(arm: Arm, late: int) -> None:
    """A small one, which a command could have caused: the setpoint says so some frames after the cameras, or first."""
    before, after = np.array([0.2, 0.1, 0.9, -0.5]), np.array([0.1, 0.2, 0.75, -0.35])
    path = np.array([before] * 5 + [after] * 5)
    setpoints = np.array([before] * (5 + late) + [after] * (5 - late))
    outcomes = follow(arm, path, Cameras(arm, 7), setpoints=setpoints)
    assert np.abs(angles(outcomes) - path).max() < 0.03


@pytest.mark.parametrize("which", ["report's", "other"])
def test_points_are_those_of_kinematics_and_jacobians_those_of_finite_differences(
    which: str, arm: Arm, rng: np.random.Generator
) -> None:
    arm = arm if which == "report's" else other_arm(3)
    model, step = MarkerModel(arm), 1e-6
    points = [*(arm.markers[name] for name in model.names), arm.chain.tip]
    for q in rng.uniform(arm.chain.limits[:, 0], arm.chain.limits[:, 1], size=(20, arm.chain.count)):
        placed = model.at(q)
        np.testing.assert_allclose(placed.points, [position(arm.chain, q, p) for p in points], atol=1e-12)
        for i in range(arm.chain.count):
            nudge = step * np.eye(arm.chain.count)[i]
            slope = (model.at(q + nudge).points - model.at(q - nudge).points) / (2 * step)
            np.testing.assert_allclose(placed.jacobians[:, :, i], slope, atol=1e-8)


def test_a_marker_on_the_axes_of_its_joints_tells_nothing_and_is_left_out(arm: Arm) -> None:
    assert MarkerModel(arm).names == ("yellow", "blue", "red")


def test_candidates_hold_the_pose_and_its_twin(arm: Arm, rng: np.random.Generator) -> None:
    candidates, cameras = Candidates(arm), Cameras(arm, 0, sigmas=0.0)
    for q in rng.uniform(arm.chain.limits[:, 0], arm.chain.limits[:, 1], size=(200, 4)):
        twin = np.array([q[0] - math.copysign(math.pi, q[0]), *-q[1:]])
        found = np.array(candidates.of(cameras.look(q, 0)))
        for wanted in (q, twin):
            assert np.abs(found - wanted).max(axis=1).min() < 1e-6
        straight = np.array([*q[:3], 0.0])  # here yellow's offset tells what the links leave open
        found = np.array(candidates.of(cameras.look(straight, 0)))
        assert np.abs(found - straight).max(axis=1).min() < 1e-4


def test_gauss_newton_reaches_the_least_of_the_cost_within_the_limits(arm: Arm, rng: np.random.Generator) -> None:
    from scipy.optimize import minimize

    model = MarkerModel(arm)
    for seed in range(10):
        q = rng.uniform(arm.chain.limits[:, 0], arm.chain.limits[:, 1])
        q[2] = arm.chain.limits[2, 1]  # at its end: noise pulls beyond it
        readings = readings_of(Cameras(arm, seed).look(q, 0), model)
        prior = Belief(q + rng.normal(0, 0.02, 4), np.eye(4) / 0.02**2)

        def cost(x: Array, readings: "object" = readings, prior: Belief = prior) -> float:
            off = readings.points - model.at(x).points[readings.rows]  # type: ignore[attr-defined]
            markers = np.einsum("mi,mij,mj->", off, readings.weights, off)  # type: ignore[attr-defined]
            return float(markers + (x - prior.mean) @ prior.information @ (x - prior.mean))

        found = fit(model, readings, prior, arm.chain.clip(prior.mean), 1.0, 10)
        slow = minimize(cost, arm.chain.clip(q), bounds=arm.chain.limits, method="L-BFGS-B", options={"ftol": 1e-15})
        assert cost(found.q) <= slow.fun + 0.05, f"seed {seed}"
        np.testing.assert_array_equal(found.q, arm.chain.clip(found.q))


@pytest.mark.parametrize("name", MOTIONS)
def test_errors_are_as_large_as_the_uncertainty_says(name: str, arm: Arm) -> None:
    path = sampled(MOTIONS[name], 2.0, 5.0)
    squares = []
    for seed in range(6):
        outcomes = follow(arm, path, Cameras(arm, seed))
        for outcome, q in zip(outcomes[30:], path[30:], strict=True):
            off = outcome.estimate.angles - q
            squares.append(off @ np.linalg.solve(outcome.track.moving.angles_covariance, off) / len(q))
    # 1 if honest; less because the fastest commanded change of speed counts as half unknown
    assert 0.4 < np.mean(squares) < 1.3, np.mean(squares)


@pytest.mark.parametrize("name", MOTIONS)
def test_lost_and_vague_markers_lower_the_weight_and_break_nothing(name: str, arm: Arm) -> None:
    path = sampled(MOTIONS[name], 4.0, 16.0)

    def hidden(k: int) -> Mapping[str, Array | None]:
        """One marker after the other: lost for 0.7 s, seen by one camera for 1.3 s, seen well for 1 s."""
        marker = ("yellow", "blue", "red")[k // 90 % 3]
        return {marker: None} if k % 90 < 20 else {marker: VAGUE} if k % 90 < 60 else {}

    outcomes = follow(arm, path, Cameras(arm, 5), hidden)
    off = np.abs(angles(outcomes) - path)
    assert (off < 5 * sigmas(outcomes) + 1e-3).all()
    assert off[:, 3].max() < 0.03
    assert max(outcome.tip_sigma for outcome in outcomes[30:]) < 0.1
    assert not any(outcome.restarted for outcome in outcomes)


def test_upright_theta_is_held_and_called_not_observable(arm: Arm) -> None:
    into = [[1.2, 0.0, share * 0.5, share * 0.6] for share in np.linspace(1.0, 0.0, 60)]
    # inside it is turned by hand, which no camera can see and no command explains
    inside = [[theta, 0.0, 0.0, 0.0] for theta in np.linspace(1.2, 2.0, 90)]
    path = np.array(into + inside)
    setpoints = path.copy()
    setpoints[60:, 0] = 1.2
    outcomes = follow(arm, path, Cameras(arm, 1, sigmas=0.0), setpoints=setpoints)
    assert not observable(outcomes)[60:, 0].any()
    assert observable(outcomes)[:40].all()
    assert observable(outcomes)[60:, 1:].all()
    np.testing.assert_allclose(angles(outcomes)[60:, 0], 1.2, atol=0.02)
    assert (np.diff(sigmas(outcomes)[70:, 0]) > 0).all(), "it says that it knows less and less"


@pytest.mark.parametrize("seed", range(5))
def test_a_wrong_branch_is_left_by_itself(arm: Arm, seed: int) -> None:
    rng = np.random.default_rng(seed)
    limits = arm.chain.limits
    q = rng.uniform(0.8 * limits[:, 0], 0.8 * limits[:, 1])
    wrong = q + rng.choice([-1, 1], 4) * rng.uniform(0.6, 1.2, 4)
    wrong = arm.chain.clip(np.where(np.abs(wrong) > limits[:, 1], 2 * q - wrong, wrong))
    outcomes = follow(arm, np.tile(q, (10, 1)), Cameras(arm, seed), setpoints=np.tile(wrong, (10, 1)))
    twin = np.array([q[0] - math.copysign(math.pi, q[0]), *-q[1:]])
    nearest = min((q, twin), key=lambda p: float(np.abs(p - wrong).sum()))
    np.testing.assert_allclose(outcomes[-1].estimate.angles, nearest, atol=0.03)
    assert not outcomes[-1].restarted


@pytest.mark.parametrize("side", [1, -1], ids=["as commanded", "its twin"])
def test_the_twin_is_never_switched(arm: Arm, side: int) -> None:
    # 14 s and 42 s touch the seam of joint 1; a restart on the way goes by the setpoint as well
    path = sampled(part2_motion, 8.0, 12.0)
    path = path if side > 0 else np.stack([path[:, 0] - math.pi, *(-path[:, 1:]).T], axis=1)
    path = path[(path[:, 0] >= -math.pi) & (path[:, 0] <= math.pi)]
    for seed in range(2):
        outcomes = follow(arm, path, Cameras(arm, seed))
        assert np.abs(angles(outcomes) - path).max() < 0.1, f"seed {seed}"
        middle = len(path) // 2
        anew = follow(arm, path[middle:], Cameras(arm, seed))
        assert np.abs(angles(anew) - path[middle:]).max() < 0.1, f"seed {seed}"


def test_an_arm_that_does_not_do_as_commanded_is_seen_where_it_is(arm: Arm) -> None:
    at, rate = np.array([0.5, 0.3, 0.8, -0.6]), np.array([0.0, 0.4, 0.0, 0.0])
    moving = np.array([at + rate * k / RATE_HZ for k in range(30)])
    blocked = np.vstack([moving, np.tile(moving[-1], (60, 1))])
    setpoints = np.array([at + rate * k / RATE_HZ for k in range(90)])
    outcomes = follow(arm, blocked, Cameras(arm, 3), setpoints=setpoints)
    # a step of 13 mrad a frame that did not happen is hidden in noise of 3 mm for some frames, no longer
    assert np.abs(angles(outcomes) - blocked).max() < 0.06
    assert np.abs(angles(outcomes)[45:] - blocked[45:]).max() < 0.03
    pushed = np.tile(at, (60, 1))
    pushed[20:, 2] += np.minimum(0.5, 0.05 * np.arange(40))
    outcomes = follow(arm, pushed, Cameras(arm, 3), setpoints=np.tile(at, (60, 1)))
    assert np.abs(angles(outcomes)[35:] - pushed[35:]).max() < 0.04


def test_a_marker_that_jumps_for_two_frames_hardly_moves_the_angles_and_one_that_stays_is_believed(arm: Arm) -> None:
    # 0.3 m of red are 0.11 rad of joint 4, which nothing else tells: only time can say whether it moved
    path = np.tile([0.5, 0.3, 0.8, -0.6], (60, 1))
    for frames in (2, 30):
        estimator, track, off = AllJoints(arm), None, []
        cameras = Cameras(arm, 2)
        for k, q in enumerate(path):
            positions = cameras.look(q, k)
            if 30 <= k < 30 + frames:
                red = positions.seen["red"]
                moved = SeenMarker(red.position + np.array([0.3, 0.0, 0.0]), red.covariance, False)
                positions = Positions(positions.capture_ns, {**positions.seen, "red": moved})
            outcome = estimator.step(track, positions, q)
            track = outcome.track
            off.append(np.abs(outcome.estimate.angles - q).max())
        if frames == 2:
            assert max(off[10:]) < 0.02
            assert max(off[45:]) < 0.01
        else:
            assert off[45] > 0.1
            assert outcome.estimate.misfit < 3


def test_an_arm_of_another_shape_is_followed_and_found(rng: np.random.Generator) -> None:
    arm = other_arm(11)
    begin = rng.uniform(-0.6, 0.6, 5)
    path = np.array([begin + 0.5 * np.sin(0.8 * k / RATE_HZ + np.arange(5)) for k in range(200)])
    outcomes = follow(arm, path, Cameras(arm, 1))
    off = np.abs(angles(outcomes) - path)
    assert (off < 5 * sigmas(outcomes) + 1e-3).all()
    lost = follow(arm, np.tile(path[0], (20, 1)), Cameras(arm, 1), setpoints=np.tile(-path[0], (20, 1)))
    assert any(outcome.restarted for outcome in lost)
    np.testing.assert_allclose(lost[-1].estimate.angles, path[0], atol=0.03)


def test_the_same_positions_give_the_same_angles_to_the_last_bit(arm: Arm) -> None:
    path = sampled(all_motion, 20.0, 2.0)
    first, second = (follow(arm, path, Cameras(arm, 9)) for _ in range(2))
    np.testing.assert_array_equal(angles(first), angles(second))


coordinate = st.floats(-50, 50)


@given(
    st.lists(
        st.tuples(
            st.dictionaries(
                st.sampled_from(["green", "yellow", "blue", "red"]),
                st.tuples(st.tuples(coordinate, coordinate, coordinate), st.floats(0, 100), st.booleans()),
            ),
            st.integers(-1, 40),
            st.lists(st.floats(-1, 1), min_size=4, max_size=4),
        ),
        min_size=1,
        max_size=12,
    )
)
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_positions_arrive_angles_are_finite_and_within_the_limits(
    arm: Arm, instants: list[tuple[dict[str, tuple[tuple[float, float, float], float, bool]], int, list[float]]]
) -> None:
    estimator, track, frame = AllJoints(arm), None, 0
    for markers, frames, shares in instants:
        frame += frames
        seen = {
            name: SeenMarker(np.array(place), np.outer(place, place) * flat + np.eye(3) * size**2 + 1e-12, flat)
            for name, (place, size, flat) in markers.items()
        }
        positions = Positions(1_700_000_000_000_000_000 + frame * 33_333_333, seen)
        setpoint = arm.chain.limits[:, 1] * shares
        try:
            outcome = estimator.step(track, positions, setpoint)
        except PositionsError:
            continue
        track = outcome.track
        assert outcome.estimate.sigma is not None
        assert outcome.estimate.velocity is not None
        for values in (outcome.estimate.angles, outcome.estimate.velocity, outcome.estimate.sigma):
            assert np.isfinite(values).all()
        assert math.isfinite(outcome.tip_sigma)
        assert (outcome.estimate.angles == arm.chain.clip(outcome.estimate.angles)).all()


def test_prediction_is_that_of_a_constant_velocity(rng: np.random.Generator) -> None:
    n, dt_s, density = 4, 0.04, rng.uniform(0.1, 2.0, 4)
    root = rng.normal(size=(2 * n, 2 * n))
    before = kalman.Moving(rng.normal(size=n), rng.normal(size=n), root @ root.T)
    after = kalman.predicted(before, dt_s, np.zeros(n), density)
    carry = np.kron([[1.0, dt_s], [0.0, 1.0]], np.eye(n))
    noise = np.kron([[dt_s**3 / 3, dt_s**2 / 2], [dt_s**2 / 2, dt_s]], np.diag(density))
    np.testing.assert_allclose(after.covariance, carry @ before.covariance @ carry.T + noise, rtol=1e-12)
    np.testing.assert_allclose(np.append(after.q, after.v), carry @ np.append(before.q, before.v))
