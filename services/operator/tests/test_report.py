"""The report's own mathematics: the judge is judged first."""

import numpy as np
import pytest

from armsight.v1.joints_pb2 import MARKER_STATUS_LOST, MARKER_STATUS_TRACKED, JointPositions
from armsight_operator.report import fixed_scale, markers, summary
from armsight_operator.report.chain import MARKER_NOISE_M, Arm, Array, arm_of, tip_from_markers
from armsight_operator.report.markers import Sample
from armsight_operator.report.measure import (
    ALL_PERIODS,
    PART1_PERIODS,
    PART2_PERIODS,
    Descent,
    Part,
    PoseRow,
    mean_squared,
    path,
)
from fake_arm import description

RNG = np.random.default_rng(20)


@pytest.fixture
def arm() -> Arm:
    return arm_of(description())


def random_q() -> Array:
    return np.asarray(
        RNG.uniform([-np.pi, -np.pi / 2, -np.pi / 2, -np.pi / 2], [np.pi, np.pi / 2, np.pi / 2, np.pi / 2])
    )


def closed_form(q: Array) -> tuple[Array, Array]:
    """Joint 4 and the tip: L1 e_z + L3 r3, and that + L4 r4, with R = Rz Ry Rx written out."""
    (s1, s2, s3, s4), (c1, c2, c3, c4) = np.sin(q), np.cos(q)
    rotation = (
        np.array([[c1, -s1, 0], [s1, c1, 0], [0, 0, 1]])
        @ np.array([[c2, 0, s2], [0, 1, 0], [-s2, 0, c2]])
        @ np.array([[1, 0, 0], [0, c3, -s3], [0, s3, c3]])
    )
    elbow = np.array([0, 0, 4.0]) + 3.2 * rotation @ np.array([0.0, 0.0, 1.0])
    return elbow, elbow + 2.8 * rotation @ np.array([s4, 0.0, c4])


def test_tip_is_that_of_the_closed_form(arm: Arm) -> None:
    for _ in range(200):
        q = random_q()
        np.testing.assert_allclose(arm.tip_at(q), closed_form(q)[1], atol=1e-12)


def test_tip_from_exact_markers_is_the_tip_in_any_frame(arm: Arm) -> None:
    for _ in range(50):
        q = random_q()
        world = {name: arm.point(q, at) + np.array([0, 0, 0.5]) for name, at in arm.markers.items()}
        np.testing.assert_allclose(arm.to_base(tip_from_markers(arm, world)), closed_form(q)[1], atol=1e-12)


def test_tip_of_this_arm_lies_fifteen_centimetres_before_red(arm: Arm) -> None:
    blue, red = np.array([1.0, 2.0, 3.0]), np.array([1.0, 2.0, 5.75])
    np.testing.assert_allclose(tip_from_markers(arm, {"blue": blue, "red": red}), [1.0, 2.0, 5.6], atol=1e-12)


@pytest.mark.parametrize(
    ("q", "free", "lost"),
    [((0, 0.3, np.pi / 2, 0), (1, 2, 3), None), ((0.7, 0, 0, 0), (0, 2, 3), 0)],
    ids=["yellow still tells nu in gimbal lock", "theta can't be seen along joint 1's axis"],
)
def test_observability_is_told_by_the_jacobian(
    arm: Arm, q: tuple[float, ...], free: tuple[int, ...], lost: int | None
) -> None:
    sigma = arm.sigma(np.array(q), free)
    assert sigma.shape == (3,)
    if lost is None:
        assert np.isfinite(sigma).all()
    else:
        assert sigma[lost] > 1.0
        assert (np.delete(sigma, lost) < 0.010).all()


def test_sigma_is_the_spread_of_a_least_squares_estimate(arm: Arm) -> None:
    q, free, step = np.array([0.4, 0.0, 0.7, -0.5]), (0, 2, 3), 1e-6

    def markers(at: Array) -> Array:
        return np.concatenate([arm.point(at, place) for place in arm.markers.values()])

    columns = []
    for joint in free:
        moved = q.copy()
        moved[joint] += step
        columns.append((markers(moved) - markers(q)) / step)
    inverse = np.linalg.pinv(np.stack(columns, axis=1))
    spread = (inverse @ RNG.normal(0, MARKER_NOISE_M, (len(inverse.T), 20_000))).std(axis=1)
    np.testing.assert_allclose(arm.sigma(q, free), spread, rtol=0.05)


@pytest.mark.parametrize("periods", [PART1_PERIODS, PART2_PERIODS, ALL_PERIODS])
def test_test_motions_keep_their_fixed_joints_and_the_limits(arm: Arm, periods: tuple[float, ...]) -> None:
    angles = np.array([path(periods, t) for t in np.linspace(0, 60, 2000)])
    fixed = [i for i, period in enumerate(periods) if not period]
    assert not angles[:, fixed].any()
    assert (np.abs(angles) <= arm.limits[:, 1] + 1e-12).all()
    np.testing.assert_allclose(angles[0], 0.0)
    moving = [i for i, period in enumerate(periods) if period]
    np.testing.assert_allclose(np.abs(angles[:, moving]).max(axis=0), arm.limits[moving, 1], rtol=1e-3)


def view(u: float, v: float) -> Array:
    """A red disc at a pixel of a grey image with a black bar and a blue disc."""
    rows, columns = np.mgrid[0:800, 0:800] + 0.5
    image = np.full((800, 800, 3), 90.0)
    image[:, 395:405] = 0.0
    image[(columns - 300) ** 2 + (rows - 300) ** 2 < 400] = (0.0, 0.0, 255.0)
    image[(columns - u) ** 2 + (rows - v) ** 2 < 100] = (200.0, 10.0, 10.0)
    return np.asarray(image)


def test_fixed_scale_takes_y_and_z_from_one_view_and_x_from_the_other() -> None:
    scale = fixed_scale.metres_per_pixel(18.0, 476.70)
    assert scale == pytest.approx(0.0378, abs=1e-4)
    # 2 m to the right of camera 1's axis and 1 m above it; 3 m to the left of camera 2's
    point = fixed_scale.end_effector(
        view(400 + 2 / scale, 400 - 1 / scale), view(400 - 3 / scale, 250), scale, camera_height_m=6.0
    )
    np.testing.assert_allclose(point, [-3.0, 2.0, 6.0 + 1.0 - 0.5], atol=0.02)


def test_fixed_scale_says_when_it_sees_nothing() -> None:
    with pytest.raises(ValueError, match="nothing red"):
        fixed_scale.red_centroid(np.full((10, 10, 3), 90.0))


SAMPLES = [
    Sample("red", lost=False, error_m=0.001, d2=3.0, visible=0.9),
    Sample("red", lost=False, error_m=0.005, d2=9.0, visible=0.4),
    Sample("red", lost=False, error_m=0.300, d2=70.0, visible=0.05),
    Sample("red", lost=False, error_m=0.010, d2=70.0, visible=0.6),
    Sample("blue", lost=True, error_m=float("nan"), d2=float("nan"), visible=0.0),
]


def test_marker_figures_tell_doubtful_from_wrong() -> None:
    told = markers.figures(SAMPLES)
    assert (told["samples"], told["lost"], told["wrong"]) == (5, 1, 1)
    assert told["visible_50"] == pytest.approx({"samples": 2, "mean": 0.0055, "p99": 0.00991, "max": 0.010})
    assert told["visible_10"]["samples"] == 3
    assert told["within_chi2_95"] == {"red": 0.25}


def test_samples_are_the_distance_from_the_true_pose(arm: Arm) -> None:
    q = np.array([0.3, -0.2, 0.5, 0.1])
    positions = JointPositions()
    for index, name in enumerate(sorted(arm.markers)):
        centre = arm.to_world(arm.point(q, arm.markers[name])) + np.array([0.0, 0.002 * index, 0.0])
        marker = positions.markers.add(name=name, status=MARKER_STATUS_TRACKED)
        marker.position.x, marker.position.y, marker.position.z = centre
        marker.covariance[:] = (np.eye(3) * 1e-6).ravel()
        for camera, visible in (("1", 0.9), ("2", 0.5)):
            marker.observations.add(camera=camera, visible=visible)
    positions.markers[0].status = MARKER_STATUS_LOST
    del positions.markers[2].observations[1]
    samples = markers.samples_of(arm, positions, q, cameras=2)
    assert [s.lost for s in samples] == [True, False, False, False]
    assert [s.error_m for s in samples[1:]] == pytest.approx([0.002, 0.004, 0.006])
    assert [s.d2 for s in samples[1:]] == pytest.approx([4.0, 16.0, 36.0])
    assert [s.visible for s in samples] == [0.5, 0.5, 0.0, 0.5]


def results() -> summary.Results:
    truth = np.array([1.0, 2.0, 3.0])
    ours, printed, method = np.diag([0.003, 0.3, 0.6])
    row = PoseRow(0.1, 0.2, 0.3, truth + ours, truth, truth + printed, truth + method)
    true = np.zeros((4, 3))
    estimated = np.array([[0.01, 0, 0], [-0.01, 0, 0], [2.0, 0, 0], [0.01, 0, 0.1]])
    observable = np.ones((4, 3), dtype=bool)
    observable[2, 0] = False
    observable[:, 1] = False
    part = Part("test-1", ("nu", "phi", "psi"), (1, 2, 3), np.arange(4.0), estimated, true, observable, SAMPLES)
    symbols = ("theta", "nu", "phi", "psi")
    still = np.zeros((4, 4))
    whole = Part("test-all", symbols, (0, 1, 2, 3), np.arange(4.0), still + 0.002, still, still == 0.0, SAMPLES)
    parts = {"part1": part, "part2": part, "all": whole}
    return summary.Results(4, True, [row, row], parts, [Descent("fixed", 4, 3)], np.array([5.0, 6.0, 50.0]))


def test_summary_counts_only_what_can_be_observed() -> None:
    told = summary.to_json(results())
    assert told["part1"]["rms"]["nu"] == pytest.approx(0.01)
    assert told["part1"]["max"]["nu"] == pytest.approx(0.01)
    assert told["part1"]["observable"] == {"nu": 0.75, "phi": 0.0, "psi": 1.0}
    assert np.isnan(told["part1"]["rms"]["phi"])
    assert told["part1"]["max"]["psi"] == pytest.approx(0.1)
    assert told["all"]["rms"] == pytest.approx(dict.fromkeys(("theta", "nu", "phi", "psi"), 0.002))


def test_summary_gives_mean_squares_over_poses_and_axes() -> None:
    told = summary.to_json(results())
    assert told["table1"]["mse"] == pytest.approx(0.003**2 / 3)
    assert told["table1"]["report_method_mse"] == pytest.approx(0.6**2 / 3)
    assert told["ik"]["fixed"]["share"] == 0.75
    assert told["latency_ms"]["p50"] == 6.0
    assert mean_squared(np.array([[3.0, 4.0, 0.0]])) == pytest.approx(25 / 3)


def test_markdown_shows_the_same_figures() -> None:
    text = summary.to_markdown(results())
    assert "| 0.1 | 0.2 | 0.3 |" in text
    assert "| 3.0 | 300 | 600 |" in text
    assert "| nu | 10.0 | 10.0 | 75 % |" in text
    assert "## All joints at once" in text
    assert "| theta | 2.0 | 2.0 | 100 % |" in text
    assert "p50 6.0 ms" in text
