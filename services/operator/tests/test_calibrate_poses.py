"""Camera poses from made-up sightings of the report's arm: derivatives, what is found, and what is refused in words."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from armsight.errors import ConfigError
from armsight_operator.calibrate.arm import marked_arm
from armsight_operator.calibrate.bundle import Problem, State, linearise, moved
from armsight_operator.calibrate.errors import UndeterminedError
from armsight_operator.calibrate.extrinsics import Measured, calibrate
from armsight_operator.calibrate.footage import Angles, find_footage
from armsight_operator.calibrate.lens import Array, Lens, project
from armsight_operator.calibrate.rigid import CameraPose, aligned, message_of_pose, pose_of, turn
from armsight_operator.calibrate.sightings import Sighting
from armsight_operator.recording.series import Limits, Series
from fake_arm import description
from recorded import arrivals, record

ARM = marked_arm(description())
LENS = Lens(800, 800, np.array([476.0, 478.0]), np.array([400.0, 398.0]), np.array([-0.2, 0.05, 1e-3, -5e-4, 0.0]))
NAMES = ("1", "2")


def looking(position: Array, at: Array) -> CameraPose:
    """A camera that stands there and looks at a point, upright."""
    z = (at - position) / np.linalg.norm(at - position)
    x = np.cross(z, (0.0, 0.0, 1.0))
    x /= np.linalg.norm(x)
    return CameraPose(np.stack([x, np.cross(z, x), z], axis=1), position)


TRUE = (
    looking(np.array([18.0, 0.4, 6.0]), np.array([0.0, 0.0, 5.0])),
    looking(np.array([1.0, -17.0, 7.0]), np.array([0.0, 0.0, 5.0])),
)
SAID = {
    name: CameraPose(
        camera.rotation @ turn(np.array([0.02, -0.04, 0.02])), camera.position + np.array([0.2, -0.1, 0.2])
    )
    for name, camera in zip(NAMES, TRUE, strict=True)
}


def angles(seed: int, count: int) -> Array:
    return np.asarray(np.random.default_rng(seed).uniform((-3, -1.1, -1.1, -1.2), (3, 1.1, 1.1, 1.2), (count, 4)))


def measured(q: Array, *, known: bool, noise_px: float = 0.03, wrong: int = 0, blind: bool = False) -> Measured:
    """What cameras at their true places see, and each marker's rough distance from its size."""
    random = np.random.default_rng(5)
    world, _ = ARM.centres(q)
    sightings: dict[tuple[int, int], list[Sighting]] = {}
    for camera, pose in enumerate(TRUE):
        for row in range(len(q)):
            points = pose.seen(world[row])
            pixels, _ = project(LENS, points)
            sightings[camera, row] = [
                Sighting(name, pixel + random.normal(0, noise_px, 2), 8.0, 1.0, point * (1 + random.normal(0, 0.01)))
                for name, pixel, point in zip(ARM.markers, pixels, points, strict=True)
                if not (blind and camera == 1)
            ]
    for row in range(wrong):
        sightings[0, row][3] = replace(sightings[0, row][3], pixel=sightings[0, row][3].pixel + 30.0)
    picture = np.zeros((800, 800, 3), dtype=np.uint8)
    return Measured(NAMES, (LENS, LENS), ARM, len(q), q if known else None, sightings, (picture, picture))


def assert_near(found: CameraPose, true: CameraPose, metres: float) -> None:
    assert np.linalg.norm(found.position - true.position) < metres
    assert np.linalg.norm(found.rotation - true.rotation) < metres / 10


def test_markers_are_where_the_reports_kinematics_put_them_and_move_as_small_steps_say() -> None:
    q = angles(1, 5)
    points, change = ARM.centres(q)
    for row, angle in enumerate(q):
        for index, name in enumerate(ARM.markers):
            np.testing.assert_allclose(
                points[row, index], ARM.arm.to_world(ARM.arm.point(angle, ARM.arm.markers[name]))
            )
    for joint in range(4):
        step = np.eye(4)[joint] * 1e-6
        numeric = (ARM.centres(q + step)[0] - ARM.centres(q - step)[0]) / 2e-6
        np.testing.assert_allclose(change[..., joint], numeric, atol=1e-7)


def test_every_derivative_of_the_residuals_is_that_of_a_small_step() -> None:
    q = angles(2, 3)
    camera, pose, marker = np.array([(c, k, m) for c in range(2) for k in range(3) for m in range(4)]).T
    problem = Problem(ARM, 3, (LENS, LENS), camera, pose, marker, np.zeros((24, 2)), np.ones(24))
    state = State(TRUE, q)
    linear = linearise(problem, state)
    for column in range(12):
        step = np.eye(12)[column] * 1e-6
        after, before = (linearise(problem, moved(problem, state, sign * step, np.zeros_like(q))) for sign in (1, -1))
        numeric = (after.residuals - before.residuals) / 2e-6
        expected = np.where((problem.camera == column // 6)[:, None], linear.by_camera[..., column % 6], 0.0)
        np.testing.assert_allclose(numeric, expected, atol=2e-5)
    for joint in range(4):
        step = np.tile(np.eye(4)[joint] * 1e-6, (3, 1))
        after, before = (linearise(problem, moved(problem, state, np.zeros(12), sign * step)) for sign in (1, -1))
        np.testing.assert_allclose((after.residuals - before.residuals) / 2e-6, linear.by_angles[..., joint], atol=2e-5)


def test_a_pose_goes_over_the_bus_and_back() -> None:
    there = pose_of(message_of_pose(TRUE[1], "2"), "2")
    np.testing.assert_allclose(there.rotation, TRUE[1].rotation, atol=1e-12)
    np.testing.assert_array_equal(there.position, TRUE[1].position)


def test_points_are_aligned_without_a_mirror() -> None:
    points = np.random.default_rng(1).normal(size=(6, 3))
    found = aligned(TRUE[0].seen(points), points, np.ones(6))
    assert_near(found, TRUE[0], 1e-9)


def test_known_angles_give_both_cameras_without_an_approximate_pose() -> None:
    found = calibrate(measured(angles(3, 30), known=True), {})
    for camera, true in zip(found.cameras, TRUE, strict=True):
        assert_near(camera.pose, true, 0.01)
        assert np.linalg.norm(camera.pose.position - true.position) < 4 * camera.position_sigma_m


def test_wrong_centres_are_left_out() -> None:
    found = calibrate(measured(angles(3, 30), known=True, wrong=5), {})
    assert found.cameras[0].left_out >= 5
    assert_near(found.cameras[0].pose, TRUE[0], 0.01)


def test_unknown_angles_leave_a_turn_about_joint_1_and_that_is_said() -> None:
    with pytest.raises(UndeterminedError) as refused:
        calibrate(measured(angles(3, 30), known=False), SAID)
    assert "cameras 1 and 2 together turn about joint1's axis, and joint1 with it" in str(refused.value)
    assert "--hold-camera" in str(refused.value)


def test_with_a_camera_held_unknown_angles_give_the_other_and_twins_are_counted() -> None:
    found = calibrate(measured(angles(3, 30), known=False), {**SAID, "1": TRUE[0]}, ["1"])
    assert found.cameras[0].held
    assert_near(found.cameras[1].pose, TRUE[1], 0.02)
    assert found.twins > 15


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        (measured(angles(3, 5), known=True), "at 5 poses, at least 8"),
        (measured(angles(3, 30), known=True, blind=True), "camera 2 sees 0 markers"),
        (measured(np.zeros((12, 4)), known=True), "all markers on one line"),
        (measured(angles(3, 30), known=True, noise_px=3.0), "px from where they should be"),
    ],
    ids=["few poses", "blind camera", "one line", "noise"],
)
def test_sightings_that_do_not_determine_poses_are_refused(seen: Measured, said: str) -> None:
    with pytest.raises(UndeterminedError, match=said):
        calibrate(seen, {})


def test_a_camera_of_which_no_centre_agrees_with_any_pose_is_refused_in_words() -> None:
    seen, random = measured(angles(3, 30), known=True), np.random.default_rng(1)
    wrong = {
        (camera, pose): [
            replace(found[0], pixel=random.uniform(0, 800, 2), place=random.uniform((-3, -3, 5), (3, 3, 20)))
        ]
        if camera
        else found
        for (camera, pose), found in seen.sightings.items()
    }
    with pytest.raises(UndeterminedError, match=r"camera 2: [0-9]+ of 30 centres don't agree with any pose") as refused:
        calibrate(replace(seen, sightings=wrong), {})
    assert "nan" not in str(refused.value)


def test_angles_of_another_arm_are_refused() -> None:
    q = angles(3, 30)
    with pytest.raises(UndeterminedError, match="intrinsics and angles"):
        calibrate(replace(measured(q, known=True), angles=q * (1.0, 0.9, 1.1, 1.0)), {})


def test_unknown_angles_need_an_approximate_pose_of_every_camera() -> None:
    with pytest.raises(ConfigError, match="no pose of camera 2"):
        calibrate(measured(angles(3, 30), known=False), {"1": SAID["1"]})


def test_footage_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", 4)
    (tmp_path / "empty").mkdir()
    (tmp_path / "pictures" / "1").mkdir(parents=True)
    (tmp_path / "pictures" / "1" / "0001.png").write_bytes(b"")
    refusals: Mapping[tuple[str, Angles], str] = {
        ("nothing.mcap", Angles.TRUE): "neither a recording",
        ("empty", Angles.UNKNOWN): "no folder of pictures for each camera",
        ("pictures", Angles.TRUE): "give --angles unknown",
        ("run.mcap", Angles.ACCEPTED): "let the arm rest at each pose",
    }
    for (name, known), said in refusals.items():
        with pytest.raises(ConfigError, match=said):
            find_footage(tmp_path / name, known, 10)


def test_a_recording_without_an_instant_that_all_cameras_show_is_refused_with_unknown_angles_too(
    tmp_path: Path,
) -> None:
    series = Series(tmp_path / "run.mcap", Limits(), {"namespace": "robots/arm"})
    for arrival in arrivals(3):
        if arrival.sample.key != "camera/2/image":
            series.write(arrival)
    series.finish("asked to stop", {})
    with pytest.raises(ConfigError, match="no instant with pictures of all cameras"):
        find_footage(tmp_path / "run.mcap", Angles.UNKNOWN, 10)


def test_instants_of_a_recording_are_those_that_differ(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", 8)
    footage = find_footage(tmp_path / "run.mcap", Angles.TRUE, 3)
    assert footage.total == 8
    assert [(instant.joints or {})["joint1"] for instant in footage.instants] == pytest.approx(
        [0.0, 0.3, 0.7], abs=0.11
    )
    assert {camera for _, camera, _ in footage.pictures()} == {"1", "2"}


def test_pictures_of_one_name_in_the_cameras_folders_are_one_instant(tmp_path: Path) -> None:
    for camera, names in (("1", ("a", "b")), ("2", ("b",))):
        (tmp_path / camera).mkdir()
        for name in names:
            Image.new("RGB", (8, 6)).save(tmp_path / camera / f"{name}.png")
    footage = find_footage(tmp_path, Angles.UNKNOWN, 10)
    assert footage.names == ("1", "2")
    assert [(index, camera) for index, camera, _ in footage.pictures()] == [(0, "1"), (1, "1"), (1, "2")]
