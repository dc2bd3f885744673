"""The file of cameras and colours: what is written is read again, and what can't be used is said by name."""

import json
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from armsight.calibration import (
    CalibrationFile,
    KnownCamera,
    checked_lens,
    checked_pose,
    read_calibration_file,
    write_calibration_file,
)
from armsight.errors import ConfigError
from armsight.v1.description_pb2 import ArmDescription, Color


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    calibration = CameraCalibration(width=640, height=480, K=[500, 0, 319.5, 0, 500, 239.5, 0, 0, 1], D=[0.1, -0.2])
    pose = FrameTransform(parent_frame_id="world", child_frame_id="camera_left_optical")
    pose.translation.x, pose.rotation.w = 1.5, 1.0
    content = CalibrationFile(
        {"left": KnownCamera(calibration, pose), "right": KnownCamera(calibration=calibration)},
        {"red": Color(red=0.9, green=0.1, blue=0.05)},
        ArmDescription(name="arm", cameras=["left", "right"]),
    )
    write_calibration_file(tmp_path / "calibration.json", content)
    assert read_calibration_file(tmp_path / "calibration.json") == content
    assert [file.name for file in tmp_path.iterdir()] == ["calibration.json"]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{", "is not JSON"),
        ("[" * 200_000, "is not JSON"),
        ('{"cameras": ' + "9" * 5000 + "}", "is not JSON"),
        ("[]", "the file is not an object"),
        ('{"camera": {}}', "the file has no camera; it may have cameras, colours, description"),
        ('{"cameras": {"1": 5}}', "camera 1 is not an object"),
        ('{"cameras": {"1": {"calibratoin": {}}}}', "camera 1 has no calibratoin; it may have calibration, pose"),
        ('{"cameras": {"1": {"calibration": {"width": -4}}}}', "calibration of camera 1 is no foxglove.Camera"),
        ('{"cameras": {"1": {"pose": {"translation": "far"}}}}', "pose of camera 1 is no foxglove.FrameTransform"),
        ('{"colours": {"red": {"red": "much"}}}', "colour of marker red is no armsight.v1.Color"),
        ('{"description": {"joints": 3}}', "the description is no armsight.v1.ArmDescription"),
    ],
)
def test_a_file_that_cannot_be_used_says_where(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(content)
    with pytest.raises(ConfigError, match=said) as refusal:
        read_calibration_file(path)
    assert str(refusal.value).startswith(str(path))


def test_a_file_that_is_not_there_and_one_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="can't be read: No such file"):
        read_calibration_file(tmp_path / "calibration.json")
    with pytest.raises(ConfigError, match="can't be written: No such file"):
        write_calibration_file(tmp_path / "no folder" / "calibration.json", CalibrationFile())


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    write_calibration_file(path, CalibrationFile(colours={"red": Color(red=1)}))
    (tmp_path / "calibration.json.part").mkdir()  # in the way of the new one
    with pytest.raises(ConfigError, match="can't be written"):
        write_calibration_file(path, CalibrationFile())
    assert json.loads(path.read_text())["colours"] == {"red": {"red": 1.0}}


K = (500.0, 0.0, 319.5, 0.0, 500.0, 239.5, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("lens", "said"),
    [
        (CameraCalibration(width=640, K=K), "no size"),
        (CameraCalibration(width=640, height=480, K=K[:8]), "9 numbers of K"),
        (CameraCalibration(width=640, height=480, K=(-500.0, *K[1:])), "focal length"),
        (CameraCalibration(width=640, height=480, K=K, D=[float("nan")]), "not finite"),
        (CameraCalibration(width=640, height=480, K=K, D=[0.1], distortion_model="equidistant"), "of another kind"),
        (CameraCalibration(width=640, height=480, K=K, D=[0.1] * 8, distortion_model="plumb_bob"), "at most 5"),
    ],
)
def test_a_lens_that_vision_could_not_use_is_refused(lens: CameraCalibration, said: str) -> None:
    with pytest.raises(ConfigError, match=f"camera left .*{said}.*calibrate intrinsics"):
        checked_lens(lens, "left")


@pytest.mark.parametrize(
    ("parent", "w", "x_m", "said"),
    [
        ("table", 1.0, 0.0, "in the frame 'table'"),
        ("world", 0.0, 0.0, "no unit quaternion"),
        ("world", float("nan"), 0.0, "no unit quaternion"),
        ("world", 1.0, float("inf"), "not finite"),
    ],
)
def test_a_pose_that_vision_could_not_use_is_refused(parent: str, w: float, x_m: float, said: str) -> None:
    pose = FrameTransform(parent_frame_id=parent)
    pose.rotation.w, pose.translation.x = w, x_m
    with pytest.raises(ConfigError, match=f"camera left .*{said}.*calibrate extrinsics"):
        checked_pose(pose, "left")


def test_what_can_be_used_gets_the_names_of_the_bus_and_stays_as_it_is_else() -> None:
    lens, pose = CameraCalibration(width=640, height=480, K=K, frame_id="mine"), FrameTransform()
    pose.rotation.w, pose.translation.y = 1.0, 2.0
    assert checked_lens(lens, "left") == CameraCalibration(width=640, height=480, K=K, frame_id="camera_left_optical")
    found = checked_pose(pose, "left")
    assert (found.parent_frame_id, found.child_frame_id) == ("world", "camera_left_optical")
    assert (found.translation, found.rotation) == (pose.translation, pose.rotation)
    assert lens.frame_id == "mine"
