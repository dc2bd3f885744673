from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from armsight.calibration import CalibrationFile, KnownCamera, write_calibration_file
from armsight.errors import ConfigError
from armsight_camera.devices import Kind, parse_devices
from armsight_camera.settings import Settings, argument_parser, parse_settings
from camera_files import HEIGHT, WIDTH, known, write_calibration, write_folder, write_video


def parsed(flags: Sequence[str]) -> Settings:
    return parse_settings(argument_parser().parse_args(flags))


def test_sources_are_told_apart(tmp_path: Path) -> None:
    folder = str(write_folder(tmp_path / "f", [1]))
    video = str(write_video(tmp_path / "v.avi", [1]))
    devices = parse_devices(["0", "left=/dev/v4l/by-id/cam", "rtsp://host/a?b=c", f"v={video}", folder])
    assert [(device.name, device.source, device.kind) for device in devices] == [
        ("1", "/dev/video0", Kind.DEVICE),
        ("left", "/dev/v4l/by-id/cam", Kind.DEVICE),
        ("3", "rtsp://host/a?b=c", Kind.URL),
        ("v", video, Kind.VIDEO),
        ("5", folder, Kind.FOLDER),
    ]


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ([], "--device 0"),
        (["0", "1=1"], "two devices are called 1"),
        (["no-such-file.avi"], "no such file"),
        (["."], "no pictures"),
        ([f"{'x' * 65}=0"], "64 letters"),
    ],
)
def test_devices_that_cannot_be_are_refused(
    given: list[str], reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=reason):
        parse_devices(given)


def test_a_folder_that_may_not_be_read_is_refused_in_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(_: Path) -> Iterator[Path]:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", denied)  # whoever runs the tests may read everything
    with pytest.raises(ConfigError, match="can't be read: Permission denied"):
        parse_devices([str(tmp_path)])


def test_a_name_that_is_too_long_for_a_file_is_refused_in_words() -> None:
    with pytest.raises(ConfigError, match="can't be read: File name too long"):
        parse_devices(["x" * 5000])


@pytest.mark.parametrize(
    ("flags", "reason"),
    [
        (["--fps", "0"], "--fps"),
        (["--fps", "nan"], "--fps"),
        (["--latency-ms", "-1"], "--latency-ms"),
        (["--max-skew-ms", "inf"], "--max-skew-ms"),
        (["--exposure", "nan"], "--exposure"),
        (["--width", "32"], "calibrated at 64 x 48"),
    ],
)
def test_values_that_cannot_work_are_refused(flags: list[str], reason: str, tmp_path: Path) -> None:
    file = write_calibration(tmp_path / "c.json", "1")
    with pytest.raises(ConfigError, match=reason):
        parsed(["--device", "0", "--calibration", str(file), *flags])


def test_exposure_is_nothing_that_a_file_could_be_asked_for(tmp_path: Path) -> None:
    file = write_calibration(tmp_path / "c.json", "1")
    folder = write_folder(tmp_path / "f", [1])
    with pytest.raises(ConfigError, match=r"--exposure.*no device"):
        parsed(["--device", str(folder), "--calibration", str(file), "--exposure", "10"])


def test_calibration_must_be_said() -> None:
    with pytest.raises(ConfigError, match=r"--calibration calibration\.json"):
        parsed(["--device", "0"])


@pytest.mark.parametrize(
    ("camera", "command"),
    [
        (KnownCamera(None, known().pose), "armsight calibrate intrinsics"),
        (KnownCamera(known().calibration, None), "armsight calibrate extrinsics"),
        (KnownCamera(known(width=0).calibration, known().pose), "armsight calibrate intrinsics"),
        (
            KnownCamera(known().calibration, FrameTransform(parent_frame_id="table")),
            "armsight calibrate extrinsics",
        ),
    ],
    ids=["no calibration", "no pose", "no size", "another frame"],
)
def test_what_is_missing_names_the_command_that_makes_it(camera: KnownCamera, command: str, tmp_path: Path) -> None:
    file = tmp_path / "c.json"
    write_calibration_file(file, CalibrationFile({"1": camera}))
    with pytest.raises(ConfigError, match=command):
        parsed(["--device", "0", "--calibration", str(file)])


def test_camera_that_the_file_does_not_know_is_told_which_it_does(tmp_path: Path) -> None:
    file = write_calibration(tmp_path / "c.json", "left", "right")
    with pytest.raises(ConfigError, match="left, right"):
        parsed(["--device", "0", "--calibration", str(file)])


def test_size_is_that_of_the_calibration_and_frames_have_the_names_of_the_bus(tmp_path: Path) -> None:
    file = write_calibration(tmp_path / "c.json", "left")
    settings = parsed(["--device", "left=0", "--calibration", str(file), "--exposure", "120"])
    assert (settings.wanted["left"].width, settings.wanted["left"].height) == (WIDTH, HEIGHT)
    assert settings.wanted["left"].exposure == 120
    camera = settings.known["left"]
    assert camera.frame_id == camera.calibration.frame_id == camera.pose.child_frame_id == "camera_left_optical"
    assert camera.pose.parent_frame_id == "world"
