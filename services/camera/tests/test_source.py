"""Real pictures and videos through the real OpenCV."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from armsight_camera.devices import Device, Kind
from armsight_camera.errors import SourceError
from armsight_camera.settings import Wanted
from armsight_camera.source import Source, open_source, rgb8
from camera_files import HEIGHT, WIDTH, picture, write_folder, write_video

WANTED = Wanted(WIDTH, HEIGHT)


def reds(source: Source) -> list[float]:
    """Mean red of each picture to the end; -1 where it can't be decoded."""
    found = []
    while source.grab():
        image = source.retrieve()
        found.append(-1.0 if image is None else float(image[..., 0].mean()))
    return found


def test_folder_gives_its_pictures_in_the_order_of_their_names(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "f", [200, 10, 90])
    (folder / "notes.txt").write_text("no picture", encoding="utf-8")
    source = open_source(Device("1", str(folder), Kind.FOLDER), WANTED)
    assert source.size() == (WIDTH, HEIGHT)
    assert reds(source) == [200, 10, 90]


def test_picture_that_cannot_be_decoded_is_none_and_the_next_one_comes(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "f", [200, 10, 90])
    (folder / "001.png").write_bytes(b"\x89PNG and nothing more")
    assert reds(open_source(Device("1", str(folder), Kind.FOLDER), WANTED)) == [200, -1, 90]


def test_video_gives_its_pictures_and_its_rate(tmp_path: Path) -> None:
    video = write_video(tmp_path / "v.avi", [200, 10, 90])
    source = open_source(Device("1", str(video), Kind.VIDEO), WANTED)
    assert source.fps == pytest.approx(25.0)
    assert source.size() == (WIDTH, HEIGHT)
    assert reds(source) == pytest.approx([200, 10, 90], abs=4), "JPEG is not exact"


def test_rate_that_was_asked_for_paces_files(tmp_path: Path) -> None:
    video = write_video(tmp_path / "v.avi", [1])
    assert open_source(Device("1", str(video), Kind.VIDEO), Wanted(WIDTH, HEIGHT, fps=10)).fps == 10
    folder = write_folder(tmp_path / "f", [1])
    assert open_source(Device("1", str(folder), Kind.FOLDER), Wanted(WIDTH, HEIGHT, fps=10)).fps == 10


def test_device_that_is_not_there_cannot_be_opened() -> None:
    with pytest.raises(SourceError, match="/dev/video99"):
        open_source(Device("1", "/dev/video99", Kind.DEVICE), WANTED)


def test_file_that_is_no_video_cannot_be_opened(tmp_path: Path) -> None:
    (tmp_path / "v.avi").write_bytes(b"nothing of the kind")
    with pytest.raises(SourceError, match=r"v\.avi"):
        open_source(Device("1", str(tmp_path / "v.avi"), Kind.VIDEO), WANTED)


def test_red_comes_first_whatever_opencv_gives() -> None:
    image = rgb8(picture(200, 100, 50))
    assert image is not None
    assert image[0, 0].tolist() == [200, 100, 50]
    grey = rgb8(np.full((HEIGHT, WIDTH), 7, dtype=np.uint8))
    assert grey is not None
    assert grey.shape == (HEIGHT, WIDTH, 3)
    assert (grey == 7).all()


@pytest.mark.parametrize(
    "given",
    [None, np.zeros((4, 4, 3), np.uint16), np.zeros((0, 0, 3), np.uint8), np.zeros((4, 4, 2), np.uint8)],
    ids=["nothing", "16 bit", "empty", "two channels"],
)
def test_what_is_no_picture_of_eight_bits_is_none(given: "np.ndarray[tuple[int, ...], np.dtype[np.generic]]") -> None:
    assert rgb8(given) is None


class Driver:
    """A V4L2 driver behind `cv2.VideoCapture`: takes some settings, rounds one, ignores another."""

    def __init__(self, source: str, backend: int) -> None:
        assert (source, backend) == ("/dev/video0", cv2.CAP_V4L2)
        self.values: dict[int, float] = {cv2.CAP_PROP_GAIN: 3.0}

    def isOpened(self) -> bool:  # noqa: N802  OpenCV's name
        return True

    def set(self, what: int, value: float) -> bool:
        if what == cv2.CAP_PROP_EXPOSURE and self.values.get(cv2.CAP_PROP_AUTO_EXPOSURE) != 1.0:
            return False
        if what != cv2.CAP_PROP_GAIN:
            self.values[what] = round(value)
        return True

    def get(self, what: int) -> float:
        return self.values.get(what, 0.0)


def test_driver_is_asked_and_what_it_did_not_take_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "VideoCapture", Driver)
    wanted = Wanted(WIDTH, HEIGHT, fps=29.97, exposure=120, gain=10, white_balance=4500)
    source = open_source(Device("1", "/dev/video0", Kind.DEVICE), wanted)
    assert source.refused == ("gain 10 (is 3)",)
    assert source.size() == (WIDTH, HEIGHT)
    assert source.fps is None, "a device is waited for"
