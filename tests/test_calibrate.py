"""From pictures of a real camera's kind to calibration.json, and from that to millimetres.

The bar is vision's own on renders without lens and noise (README: markers that both cameras see to 50 % or more within
2 mm on average, 6 mm at p99), within a factor of 2.
"""

import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from google.protobuf.json_format import Parse
from PIL import Image

from armsight import topics
from armsight.bus import Sample
from armsight.calibration import CalibrationFile, KnownCamera, read_calibration_file, write_calibration_file
from armsight.images import encode_rgb8
from armsight.times import NS_PER_S, to_timestamp
from armsight.v1.joints_pb2 import JointPositions
from armsight_operator.calibrate.board import draw_board, parse_board
from armsight_operator.cli.app import main
from armsight_operator.recording.backlog import Arrival
from armsight_operator.recording.series import Limits, Series
from armsight_operator.stack.executables import find_executable
from armsight_sim import description
from rendered_video import LENSES, SIDE, ArmFilm, Picture, board_film, poses

SEED = 4021
"""Nobody looked at it while this was developed: seeds 1 and 2 were for that."""
START_NS = 1_700_000_000 * NS_PER_S
BOARD = ("--board", "charuco:9x7", "--square-m", "0.1", "--marker-m", "0.075", "--dictionary", "5X5_100")
CALIBRATED, HELD_OUT = 36, 24

pytestmark = pytest.mark.untimed


def armsight(*words: str) -> int:
    """The exit code of a command."""
    with pytest.raises(SystemExit) as ended:
        main(words)
    return int(ended.value.code or 0)


class Film:
    """A recording for calibration, pictures of the board, and held-out pictures with the truth."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder, self.recording = folder, folder / "poses.mcap"
        self.held_out: list[tuple[dict[str, Path], dict[str, npt.NDArray[np.float64]]]] = []
        film = ArmFilm(seed)
        self.described = description.describe_arm(film.described)
        self.said = {
            name: KnownCamera(
                description.calibration(film.described, name, SIDE, SIDE, START_NS),
                description.camera_pose(film.described, name, START_NS),
            )
            for name in LENSES
        }
        self.true_poses = {name: description.camera_pose(film.model, name, START_NS) for name in LENSES}
        every = poses(seed, CALIBRATED + HELD_OUT)
        try:
            self._record((q, film.take(q)) for q in every[:CALIBRATED])
            for number, q in enumerate(every[CALIBRATED:]):
                taken = {name: folder / f"held-{name}-{number}.png" for name in LENSES}
                for name, picture in film.take(q).items():
                    Image.fromarray(picture).save(taken[name], compress_level=1)
                self.held_out.append((taken, film.markers()))
        finally:
            film.close()
        board = parse_board("charuco:9x7", 0.1, 0.075, "5X5_100")
        texture = draw_board(board, 60)
        for name, lens in LENSES.items():
            (folder / f"board-{name}").mkdir()
            size_m = np.array(texture.shape[::-1]) / 60 * board.square_m
            for number, picture in enumerate(board_film(lens, texture, size_m, seed, 27)):
                Image.fromarray(picture).save(folder / f"board-{name}" / f"{number:02}.png", compress_level=1)

    def _record(self, instants: Iterator[tuple[npt.NDArray[np.float64], dict[str, Picture]]]) -> None:
        series = Series(self.recording, Limits(), {"namespace": "robots/arm"})
        sequences: dict[str, int] = {}

        def put(topic: topics.Topic[Any], name: str, stamp_ns: int, payload: bytes) -> None:
            sample = Sample(topic, name, payload, b"")
            sequences[sample.key] = sequences.get(sample.key, 0) + 1
            series.write(Arrival(sample, stamp_ns, sequences[sample.key]))

        put(topics.DESCRIPTION, "", START_NS, self.described.SerializeToString())
        for name, camera in self.said.items():
            assert camera.calibration is not None
            assert camera.pose is not None
            put(topics.CAMERA_CALIBRATION, name, START_NS, camera.calibration.SerializeToString())
            put(topics.CAMERA_POSE, name, START_NS, camera.pose.SerializeToString())
        for number, (q, pictures) in enumerate(instants):
            moved_ns = START_NS + number * NS_PER_S
            joints = [JointState(name=f"joint{i + 1}", position=angle) for i, angle in enumerate(q)]
            accepted = JointStates(timestamp=to_timestamp(moved_ns), joints=joints)
            put(topics.JOINTS_ACCEPTED, "", moved_ns, accepted.SerializeToString())
            taken_ns = moved_ns + NS_PER_S // 2
            for name, picture in pictures.items():
                image = encode_rgb8(picture.tobytes(), SIDE, SIDE, f"camera_{name}_optical", taken_ns)
                put(topics.CAMERA_IMAGE, name, taken_ns, image)
        series.finish("asked to stop", {})

    def errors_m(self, calibration: Path, cameras: int = 2) -> npt.NDArray[np.float64]:
        """Of markers that so many cameras or more see to 50 % or more, in the held-out pictures."""
        errors = []
        for pictures, truth in self.held_out:
            images = [word for name, path in pictures.items() for word in ("--image", f"{name}={path}")]
            words = [str(find_executable("vision")), "--calibration", str(calibration), *images]
            done = subprocess.run(words, capture_output=True, text=True, check=True)
            for marker in Parse(done.stdout, JointPositions()).markers:
                if sum(seen.visible >= 0.5 for seen in marker.observations) >= cameras:
                    found = np.array([marker.position.x, marker.position.y, marker.position.z])
                    errors.append(float(np.linalg.norm(found - truth[marker.name])))
        return np.array(errors)


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Film:
    return Film(tmp_path_factory.mktemp("film"), SEED)


@pytest.fixture(scope="module")
def calibrated(film: Film) -> Path:
    """What a person gets who types the commands of docs/calibrate.md."""
    file = film.folder / "calibration.json"
    for name in LENSES:
        source, picture = str(film.folder / f"board-{name}"), str(film.folder / f"lens-{name}.png")
        lens = ("--camera", name, *BOARD, "--calibration", str(file), "--picture", picture)
        assert armsight("calibrate", "intrinsics", source, *lens) == 0
    words = ("--calibration", str(file), "--picture", str(film.folder / "poses.png"))
    assert armsight("calibrate", "extrinsics", str(film.recording), *words) == 0
    return file


def test_measuring_with_what_was_found_is_within_twice_visions_own_bar(film: Film, calibrated: Path) -> None:
    errors = film.errors_m(calibrated)
    mean, p99 = errors.mean(), np.percentile(errors, 99)
    print(f"seed {SEED}: {len(errors)} markers, mean {mean * 1e3:.2f} mm, p99 {p99 * 1e3:.2f} mm")
    assert len(errors) > 2 * HELD_OUT
    assert mean <= 2 * 0.002
    assert p99 <= 2 * 0.006


def test_measuring_with_what_was_said_is_off_by_far_more(film: Film) -> None:
    file = film.folder / "said.json"
    write_calibration_file(file, CalibrationFile(film.said, description=film.described))
    # the views disagree so far that vision takes one of them, or none
    errors = film.errors_m(file, cameras=1)
    print(f"seed {SEED}: as described, {len(errors)} markers, median {np.median(errors) * 1e3:.0f} mm")
    assert len(errors) > HELD_OUT
    assert np.median(errors) > 0.05


def test_the_camera_is_found_where_it_really_is(film: Film, calibrated: Path) -> None:
    for name, camera in read_calibration_file(calibrated).cameras.items():
        assert camera.pose is not None
        true = film.true_poses[name]
        apart = [getattr(camera.pose.translation, axis) - getattr(true.translation, axis) for axis in "xyz"]
        assert np.linalg.norm(apart) < 0.05, name
        same = abs(sum(getattr(camera.pose.rotation, axis) * getattr(true.rotation, axis) for axis in "wxyz"))
        assert 2 * np.arccos(min(1.0, same)) < 0.002, name


def test_the_lens_is_the_one_that_the_pictures_were_bent_by(calibrated: Path) -> None:
    cameras = read_calibration_file(calibrated).cameras
    for name, true in LENSES.items():
        found = cameras[name].calibration
        assert found is not None
        assert found.K[0] == pytest.approx(true.focal, abs=2.0)
        assert (found.K[2], found.K[5]) == pytest.approx(true.centre, abs=1.5)
        assert list(found.D[:2]) == pytest.approx([true.k1, true.k2], abs=0.004)


def test_unknown_angles_are_refused_in_words_and_nothing_is_written(
    film: Film, calibrated: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "calibration.json"
    file.write_bytes(calibrated.read_bytes())
    words = ("calibrate", "extrinsics", str(film.recording), "--angles", "unknown", "--calibration", str(file))
    assert armsight(*words) == 1
    assert "cameras 1 and 2 together turn about joint1's axis, and joint1 with it" in capsys.readouterr().err
    assert file.read_bytes() == calibrated.read_bytes()


def test_with_one_camera_held_unknown_angles_are_no_obstacle(film: Film, calibrated: Path, tmp_path: Path) -> None:
    file = tmp_path / "calibration.json"
    content = read_calibration_file(calibrated)
    # camera 2 was moved after both had been calibrated
    started: Mapping[str, KnownCamera] = {
        "1": content.cameras["1"],
        "2": KnownCamera(content.cameras["2"].calibration, film.said["2"].pose),
    }
    write_calibration_file(file, CalibrationFile(started, description=film.described))
    words = ("--angles", "unknown", "--hold-camera", "1", "--calibration", str(file))
    assert armsight("calibrate", "extrinsics", str(film.recording), *words) == 0
    errors = film.errors_m(file)
    assert errors.mean() <= 2 * 0.002
    assert np.percentile(errors, 99) <= 2 * 0.006


def test_colours_that_were_learnt_where_markers_are_expected_are_found_by_vision(
    film: Film, calibrated: Path, tmp_path: Path
) -> None:
    file = tmp_path / "calibration.json"
    file.write_bytes(calibrated.read_bytes())
    picture = tmp_path / "cones.png"
    words = ("--camera", "1", "--known-order", "--calibration", str(file), "--picture", str(picture))
    assert armsight("calibrate", "colours", str(film.recording), *words) == 0
    assert picture.is_file()
    content = read_calibration_file(file)
    assert set(content.colours) == {"red", "green", "blue", "yellow"}
    assert content.description is not None
    for marker in content.description.markers:
        assert marker.color == content.colours[marker.name]
    errors = film.errors_m(file)
    assert len(errors) > 2 * HELD_OUT
    assert errors.mean() <= 2 * 0.002
