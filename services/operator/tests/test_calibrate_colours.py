"""Learning colours from painted pictures."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw

from armsight.calibration import read_calibration_file
from armsight_operator.calibrate.colours import check_apart, hue_and_saturation, learn_at, learn_near, taken
from armsight_operator.calibrate.errors import UndeterminedError
from armsight_operator.calibrate.frames import Picture
from armsight_operator.cli.app import main

PAINT = {"red": (170, 40, 30), "blue": (40, 60, 160), "yellow": (180, 160, 30)}
PLACES = {"red": (60, 60), "blue": (150, 80), "yellow": (100, 150)}


def painted(*more: tuple[tuple[int, int, int], tuple[int, int, int, int]], noise: float = 2.0) -> Picture:
    """Shaded discs of radius 14 on grey, and boxes beside them."""
    image = Image.new("RGB", (220, 200), (180, 180, 180))
    pen = ImageDraw.Draw(image)
    for name, (x, y) in PLACES.items():
        for radius, share in ((14, 0.6), (10, 0.8), (6, 1.0)):
            ink = tuple(round(share * part) for part in PAINT[name])
            pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=ink)
    for ink, box in more:
        pen.rectangle(box, fill=ink)
    noisy = np.asarray(image) + np.random.default_rng(1).normal(0, noise, (200, 220, 3))
    return np.asarray(np.clip(np.rint(noisy), 0, 255), dtype=np.uint8)


def colours(path: Path, *words: str) -> int:
    file = str(path.parent / "calibration.json")
    with pytest.raises(SystemExit) as ended:
        main(["calibrate", "colours", str(path), "--camera", "1", "--calibration", file, *words])
    return int(ended.value.code or 0)


def clicks() -> list[str]:
    return [word for name, (x, y) in PLACES.items() for word in ("--at", f"{name}={x},{y}")]


def test_a_colour_is_that_of_the_paint_whatever_the_shade() -> None:
    for name, (x, y) in PLACES.items():
        found = learn_at(painted(), x, y)
        paint = np.array(PAINT[name]) / max(PAINT[name])
        np.testing.assert_allclose(found.colour, paint, atol=0.02)
        assert found.mask.sum() == pytest.approx(np.pi * 14**2, rel=0.1)


def test_a_place_on_a_highlight_gives_the_marker_and_not_what_is_around_it() -> None:
    picture = painted()
    x, y = PLACES["red"]
    picture[y, x] = (255, 255, 255)
    found = learn_at(picture, x, y)
    np.testing.assert_allclose(found.colour, np.array(PAINT["red"]) / max(PAINT["red"]), atol=0.02)
    assert found.mask.sum() == pytest.approx(np.pi * 14**2, rel=0.1)


def test_pixels_are_taken_by_the_marker_that_they_belong_to() -> None:
    picture = painted()
    owner = taken(picture, {name: np.array(ink, dtype=float) for name, ink in PAINT.items()})
    for number, (x, y) in enumerate(PLACES.values()):
        assert (owner[y - 5 : y + 6, x - 5 : x + 6] == number).all()
    assert owner[190, 10] == -1


def test_markers_near_their_expected_places_are_learnt_by_place_and_not_by_hue() -> None:
    near = {name: (x + 6.0, y - 5.0) for name, (x, y) in PLACES.items()}
    found = learn_near(painted(), near, dict.fromkeys(PLACES, 13.0))
    for name in PLACES:
        np.testing.assert_allclose(found[name].colour, np.array(PAINT[name]) / max(PAINT[name]), atol=0.02)


def test_the_file_gets_the_colours_and_the_picture_shows_them(tmp_path: Path) -> None:
    Image.fromarray(painted()).save(tmp_path / "view.png")
    assert colours(tmp_path / "view.png", *clicks(), "--picture", str(tmp_path / "cones.png")) == 0
    written = read_calibration_file(tmp_path / "calibration.json").colours
    assert set(written) == set(PAINT)
    with Image.open(tmp_path / "cones.png") as drawn:
        red, green, blue = drawn.getpixel(PLACES["red"])  # type: ignore[misc]
    assert red > 2 * max(green, blue)


def test_grey_is_no_marker(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Image.fromarray(painted()).save(tmp_path / "view.png")
    assert colours(tmp_path / "view.png", "--at", "red=10,190") == 1
    assert "grey or dark" in capsys.readouterr().err


def test_background_of_a_markers_colour_is_refused_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Image.fromarray(painted(((90, 22, 16), (170, 160, 215, 195)))).save(tmp_path / "view.png")
    assert colours(tmp_path / "view.png", *clicks()) == 1
    assert "have the colour of red" in capsys.readouterr().err
    assert not (tmp_path / "calibration.json").exists()


def test_hues_nearer_than_vision_tells_apart_are_refused() -> None:
    red, orange = np.array([1.0, 0.2, 0.2]), np.array([1.0, 0.3, 0.2])
    assert np.degrees(hue_and_saturation(orange)[0] - hue_and_saturation(red)[0]) % 360 < 12
    with pytest.raises(UndeterminedError, match="red and orange are"):
        check_apart({"red": red, "orange": orange})
    check_apart({"red": red, "orange": np.array([1.0, 0.5, 0.2])})


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "either --at"),
        (["--at", "red=1"], "no NAME=COLUMN,ROW"),
        (["--at", "red=999,1"], "outside of the picture"),
        (["--known-order"], "neither a recording"),
    ],
)
def test_command_lines_that_cannot_be_used_are_named(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Image.fromarray(painted()).save(tmp_path / "view.png")
    assert colours(tmp_path / "view.png", *words) == 2
    assert said in capsys.readouterr().err


def test_without_opencv_it_is_said_what_to_install(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    assert colours(tmp_path / "view.png", "--at", "red=1,1") == 2
    assert "pip install 'armsight-operator[calibrate]'" in capsys.readouterr().err
