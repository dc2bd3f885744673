"""A file of cameras and colours in place of the model's."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from armsight.calibration import CalibrationFile, KnownCamera, recoloured, write_calibration_file
from armsight.errors import ConfigError
from armsight.v1.description_pb2 import Color
from armsight_sim import description
from armsight_sim.recalibration import read_recalibration
from armsight_sim.world import load_model

SIZES = {"1": (800, 800), "2": (800, 800)}
MARKERS = frozenset({"red", "green", "blue", "yellow"})
EXECUTABLE = Path(sys.executable).parent / "armsight-sim"


def known(width: int = 800) -> KnownCamera:
    model = load_model()
    return KnownCamera(description.calibration(model, "2", width, 800, 0), description.camera_pose(model, "2", 0))


def test_what_the_file_says_is_taken_and_nothing_else_changes(tmp_path: Path) -> None:
    colour = Color(red=0.9, green=0.1, blue=0.2)
    write_calibration_file(tmp_path / "c.json", CalibrationFile({"2": known()}, {"red": colour}))
    content = read_recalibration(tmp_path / "c.json", SIZES, MARKERS)
    assert content.cameras == {"2": known()}
    before = description.describe_arm(load_model())
    after = recoloured(before, content)
    assert {m.name: m.color for m in after.markers if m.name == "red"} == {"red": colour}
    assert [m for m in after.markers if m.name != "red"] == [m for m in before.markers if m.name != "red"]


def test_without_a_file_the_models_own_holds() -> None:
    assert read_recalibration(None, SIZES, MARKERS) == CalibrationFile()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (CalibrationFile({"3": known()}), "camera 3 is none of the model's, which are 1, 2"),
        (
            CalibrationFile({"2": KnownCamera(pose=FrameTransform())}),
            "camera 2 has a rotation that is no unit quaternion",
        ),
        (CalibrationFile({"2": known(640)}), "640 x 800, sim draws 800 x 800"),
        (CalibrationFile({}, {"pink": Color(red=1)}), "no marker pink"),
    ],
)
def test_files_that_do_not_fit_to_the_model_are_refused(content: CalibrationFile, said: str, tmp_path: Path) -> None:
    write_calibration_file(tmp_path / "c.json", content)
    with pytest.raises(ConfigError, match=said):
        read_recalibration(tmp_path / "c.json", SIZES, MARKERS)


def test_a_file_that_does_not_fit_ends_the_process_before_it_is_on_the_bus(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text(json.dumps({"cameras": {"9": {}}}))
    done = subprocess.run(
        [EXECUTABLE, "--calibration", str(tmp_path / "c.json")], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 2
    assert "camera 9 is none of the model's" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_of_cameras_that_are_somebody_elses_the_file_is_for_them(tmp_path: Path) -> None:
    lens = CameraCalibration(width=640, height=480)
    content = CalibrationFile({"left": KnownCamera(lens)}, {"red": Color(red=0.7)})
    write_calibration_file(tmp_path / "c.json", content)
    assert read_recalibration(tmp_path / "c.json", None, MARKERS).colours["red"].red == 0.7
