"""Lenses: derivatives, the board, and every reason for which pictures are refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from armsight.calibration import read_calibration_file
from armsight.errors import ConfigError
from armsight_operator.calibrate.board import Board, Corners, draw_board, find_corners, parse_board, write_board
from armsight_operator.calibrate.errors import UndeterminedError
from armsight_operator.calibrate.frames import frames
from armsight_operator.calibrate.intrinsics import calibrate
from armsight_operator.calibrate.lens import Array, Lens, lens_of, message_of, project, reaches
from armsight_operator.calibrate.rigid import turn
from armsight_operator.calibrate.views import Seen, View, informative
from armsight_operator.cli.app import main
from recorded import record

LENS = Lens(640, 480, np.array([420.0, 425.0]), np.array([322.0, 236.0]), np.array([-0.2, 0.05, 1e-3, -5e-4, 0.0]))
BOARD = Board("charuco", 9, 7, 0.1, 0.07, "5X5_100")
GRID = np.array([[x, y, 0.0] for y in range(1, 7) for x in range(1, 9)]) * 0.1


def views(seed: int, count: int, tilt: float = 0.5, reach: float = 0.8) -> tuple[View, ...]:
    """Made-up corners of a board at many places, with noise of 0.1 px."""
    random = np.random.default_rng(seed)
    made = []
    for number in range(count):
        rotation = turn(np.array([*random.uniform(-tilt, tilt, 2), random.uniform(-0.3, 0.3)]))
        middle = np.array([(number % 3 - 1) * 0.7 * reach, (number // 3 % 3 - 1) * 0.5 * reach, 1.0])
        shift = middle * random.uniform(0.9, 1.5) - rotation @ np.array([0.45, 0.35, 0.0])
        pixels, _ = project(LENS, GRID @ rotation.T + shift)
        inside = ((pixels > 0) & (pixels < (LENS.width - 1, LENS.height - 1))).all(axis=1)
        pixels = pixels + random.normal(0, 0.1, pixels.shape)
        place = pixels[[0, 7, 47, 40]] / 800
        made.append(View(f"{number:02}", Corners(GRID[inside], pixels[inside]), 1.0, place))
    return tuple(view for view in made if len(view.corners.pixels) >= 12)


def seen(of: tuple[View, ...]) -> Seen:
    return Seen(LENS.width, LENS.height, of, len(of), np.zeros((LENS.height, LENS.width, 3), dtype=np.uint8))


def test_the_projections_derivatives_are_those_of_small_steps() -> None:
    points = np.random.default_rng(3).uniform((-0.8, -0.8, 1.0), (0.8, 0.8, 3.0), (20, 3))
    _, slope = project(LENS, points)
    for axis in range(3):
        step = np.eye(3)[axis] * 1e-6
        numeric = (project(LENS, points + step)[0] - project(LENS, points - step)[0]) / 2e-6
        np.testing.assert_allclose(slope[..., axis], numeric, rtol=1e-6, atol=1e-5)


def test_a_lens_goes_over_the_bus_and_back() -> None:
    there = lens_of(message_of(LENS, "1"), "1")
    np.testing.assert_array_equal(there.matrix, LENS.matrix)
    np.testing.assert_array_equal(there.distortion, LENS.distortion)


def test_a_distortion_that_folds_within_the_picture_is_noticed() -> None:
    folded = Lens(640, 480, LENS.focal, LENS.centre, np.array([-0.6, 0.0, 0.0, 0.0, 0.0]))
    assert reaches(LENS)
    assert not reaches(folded)


def test_the_lens_that_made_the_corners_is_found_and_its_uncertainty_is_true() -> None:
    found = calibrate(seen(views(1, 36)))
    parameters = np.array([*found.lens.focal, *found.lens.centre, *found.lens.distortion])
    true = np.array([*LENS.focal, *LENS.centre, *LENS.distortion])
    known = found.sigma > 0
    assert (np.abs(parameters - true)[known] < 4 * found.sigma[known]).all()
    assert found.rms_px == pytest.approx(0.1 * np.sqrt(2), rel=0.15)


def test_what_the_pictures_do_not_show_of_a_lens_is_left_at_zero() -> None:
    assert calibrate(seen(views(1, 36))).lens.distortion[4] == 0.0


def test_a_view_that_agrees_with_no_lens_is_left_out() -> None:
    good = views(2, 36)
    bent = Corners(
        good[5].corners.on_board,
        good[5].corners.pixels + np.random.default_rng(1).normal(0, 4, (len(good[5].corners.pixels), 2)),
    )
    mixed = (*good[:5], View("bent", bent, 1.0, good[5].place), *good[6:])
    assert calibrate(seen(mixed)).rejected == ("bent",)


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (views(1, 6), "6 pictures of 6 show the board"),
        (views(1, 30, tilt=0.05), "focal length and distance can't be told apart"),
        (views(1, 30, reach=0.1), "record the board in all four corners"),
    ],
    ids=["few", "not tilted", "only in the middle"],
)
def test_pictures_that_do_not_determine_a_lens_are_refused(made: tuple[View, ...], said: str) -> None:
    with pytest.raises(UndeterminedError, match=said):
        calibrate(seen(made))


def test_a_board_of_another_shape_than_named_is_refused() -> None:
    stretched = tuple(
        View(
            v.name,
            Corners(v.corners.on_board * (1.0, 1.3, 1.0) + 0.1 * v.corners.on_board[:, [0]] ** 2, v.corners.pixels),
            1.0,
            v.place,
        )
        for v in views(1, 36)
    )
    with pytest.raises(UndeterminedError, match="not as --board says"):
        calibrate(seen(stretched))


def test_views_that_are_alike_or_blurred_are_not_taken() -> None:
    good = views(4, 18)
    blurred = View("blurred", good[0].corners, 0.1, good[0].place + 0.5)
    again = View("again", good[3].corners, 1.0, good[3].place + 1e-4)
    names = {view.name for view in informative([*good, blurred, again])}
    assert "blurred" not in names
    assert len({"again", "03"} & names) == 1


@pytest.mark.parametrize("board", [BOARD, Board("checkerboard", 9, 6, 0.05)], ids=["charuco", "checkerboard"])
def test_corners_of_a_board_are_found_where_it_was_drawn(board: Board) -> None:
    drawn = draw_board(board, 60)
    found = find_corners(board, drawn)
    assert found is not None
    # squares begin after a margin of half of one; the outline of pixel (i, j) is at i - 0.5
    expected: Array = found.on_board[:, :2] / board.square_m * 60 + 30 - 0.5
    if board.kind == "checkerboard":
        expected = expected + 60
        if np.abs(found.pixels - expected).max() > 1:  # a checkerboard looks the same after half a turn
            expected = expected[::-1]
    np.testing.assert_allclose(found.pixels, expected, atol=0.1)


def test_a_printed_board_has_its_size(tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["calibrate", "board", str(tmp_path / "board.png"), "--square-m", "0.04", "--marker-m", "0.03"])
    assert not ended.value.code
    with Image.open(tmp_path / "board.png") as drawn:
        assert drawn.width / drawn.info["dpi"][0] * 0.0254 == pytest.approx(8 * 0.04, rel=1e-3)


@pytest.mark.parametrize(("square_m", "marker_m"), [(0.01, 0.002), (0.001, 0.0008), (50.0, 40.0)])
def test_a_board_whose_markers_have_no_pixels_at_this_resolution_is_not_drawn(
    square_m: float, marker_m: float, tmp_path: Path
) -> None:
    board = parse_board("charuco:7x5", square_m, marker_m, "7X7_50")
    with pytest.raises(ConfigError, match="change --dpi"):
        write_board(board, tmp_path / "board.png", 50)


@pytest.mark.parametrize(
    ("text", "square_m", "marker_m", "dictionary", "said"),
    [
        ("chess:9x6", 0.1, None, "4X4_50", "neither charuco"),
        ("charuco:7x5", 0.0, 0.01, "4X4_50", "--square-m"),
        ("charuco:7x5", 0.1, None, "4X4_50", "--marker-m"),
        ("charuco:7x5", 0.1, 0.2, "4X4_50", "--marker-m"),
        ("charuco:7x5", 0.1, 0.05, "9X9", "--dictionary"),
        ("charuco:7x5", 1e308, 1e307, "4X4_50", "--square-m"),
        ("charuco:20x20", 0.1, 0.05, "4X4_50", "has 200 markers"),
        ("checkerboard:2x9", 0.1, None, "4X4_50", "at least 3"),
    ],
)
def test_boards_that_are_none_are_named(
    text: str, square_m: float, marker_m: float | None, dictionary: str, said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        parse_board(text, square_m, marker_m, dictionary)


def test_inputs_that_cannot_be_used_are_named_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "calibration.json"
    (tmp_path / "empty").mkdir()
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "a.png").write_bytes(b"none")
    (tmp_path / "mixed").mkdir()
    Image.new("RGB", (64, 64)).save(tmp_path / "mixed" / "a.png")
    Image.new("RGB", (64, 32)).save(tmp_path / "mixed" / "b.png")
    (tmp_path / "video.avi").write_bytes(b"none")
    (tmp_path / "run.mcap").write_bytes(b"none")
    for source, said in (
        ("empty", "no pictures of camera 1"),
        ("broken", "can't be read as a picture"),
        ("mixed", "of another size"),
        ("video.avi", "can't be read as a video"),
        ("run.mcap", "no MCAP file"),
        ("nothing", "there is no"),
    ):
        words = ["--camera", "1", "--board", "checkerboard:9x6", "--square-m", "0.1", "--calibration", str(file)]
        with pytest.raises(SystemExit) as ended:
            main(["calibrate", "intrinsics", str(tmp_path / source), *words])
        assert ended.value.code == 2, source
        assert said in capsys.readouterr().err
    assert not file.exists()


@pytest.mark.parametrize("camera", ["", "left eye", "../1", "*", "ü"])
def test_a_camera_that_the_bus_could_not_name_is_not_written(
    camera: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--camera", camera, "--board", "checkerboard:9x6", "--square-m", "0.1"]
    with pytest.raises(SystemExit) as ended:
        main(["calibrate", "intrinsics", str(tmp_path), *words])
    assert ended.value.code == 2
    assert f"--camera {camera!r}" in capsys.readouterr().err


def test_pictures_without_a_board_are_refused_with_exit_code_1_and_the_file_stays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "calibration.json"
    file.write_text('{"colours": {"red": {"red": 1.0}}}')
    Image.new("RGB", (64, 64)).save(tmp_path / "a.png")
    words = ["--camera", "1", "--board", "checkerboard:9x6", "--square-m", "0.1", "--calibration", str(file)]
    with pytest.raises(SystemExit) as ended:
        main(["calibrate", "intrinsics", str(tmp_path), *words])
    assert ended.value.code == 1
    assert "0 pictures of 1 show the board" in capsys.readouterr().err
    content = read_calibration_file(file)
    assert not content.cameras
    assert content.colours["red"].red == 1.0


def test_pictures_come_from_videos_and_recordings_as_from_files(tmp_path: Path) -> None:
    red = np.zeros((48, 64, 3), dtype=np.uint8)
    red[..., 2] = 200  # OpenCV's order
    video = cv2.VideoWriter(str(tmp_path / "video.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    for _ in range(5):
        video.write(red)
    video.release()
    record(tmp_path / "run.mcap", 5)
    seen_in_video = list(frames(tmp_path / "video.avi", "1", every=2))
    assert [frame.name for frame in seen_in_video] == ["picture 0", "picture 2", "picture 4"]
    assert seen_in_video[0].rgb[24, 32] == pytest.approx((200, 0, 0), abs=4)
    assert [frame.rgb.shape for frame in frames(tmp_path / "run.mcap", "2")] == [(16, 16, 3)] * 5
