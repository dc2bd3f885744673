"""Where pictures are taken from, one after the other: devices, URLs, videos and folders, through OpenCV.

Taking is two steps, as in OpenCV: `grab` waits for a frame, whose time is the moment it returns, and `retrieve` decodes
it, which may take a while.
"""

import logging
import math
from itertools import count
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
import numpy.typing as npt

from armsight.errors import ConfigError
from armsight.pictures import pictures_in
from armsight_camera.devices import Device, Kind
from armsight_camera.errors import SourceError
from armsight_camera.settings import Wanted

log = logging.getLogger(__name__)

Image = npt.NDArray[np.uint8]

DEFAULT_FPS = 30.0
"""Of folders, and of videos that don't say."""

# V4L2's exposure_auto, through OpenCV
_MANUAL_EXPOSURE = 1.0
_CLOSE = 0.01
"""A driver that rounds a value by this share has taken it."""


class Source(Protocol):
    """One open source of pictures."""

    refused: tuple[str, ...]
    """What the driver was asked for and did not take, for a person."""
    fps: float | None
    """How fast pictures are to be taken; none: `grab` waits for them."""

    def size(self) -> tuple[int, int] | None:
        """Columns and rows, where the source says them before the first picture."""

    def grab(self) -> bool:
        """Waits for the next frame; false: there is none any more."""

    def retrieve(self) -> Image | None:
        """The frame that was grabbed, rgb8, (height, width, 3), the top row first; none: it can't be decoded."""

    def close(self) -> None:
        """Lets the driver go."""


class CapturedSource:
    """A device, a URL or a video file."""

    def __init__(self, device: Device, wanted: Wanted) -> None:
        """Opens it and asks the driver for what is wanted.

        Raises:
            SourceError: it can't be opened.
        """
        backend = cv2.CAP_V4L2 if device.kind is Kind.DEVICE else cv2.CAP_FFMPEG
        self._capture = cv2.VideoCapture(device.source, backend)
        if not self._capture.isOpened():
            self._capture.release()
            raise SourceError(f"{device.source} can't be opened")
        self.refused = self._ask(wanted) if device.kind is Kind.DEVICE else ()
        self.fps = None
        if device.kind is Kind.VIDEO:
            own = self._capture.get(cv2.CAP_PROP_FPS)
            self.fps = wanted.fps or (own if math.isfinite(own) and own > 0.0 else DEFAULT_FPS)

    def size(self) -> tuple[int, int] | None:
        """As the driver says; it may say nothing."""
        width, height = (int(self._capture.get(p)) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        return (width, height) if width > 0 and height > 0 else None

    def grab(self) -> bool:
        """Waits for the driver."""
        return bool(self._capture.grab())

    def retrieve(self) -> Image | None:
        """Decodes."""
        decoded, image = self._capture.retrieve()
        return rgb8(image) if decoded else None

    def close(self) -> None:
        """Lets the driver go."""
        self._capture.release()

    def _ask(self, wanted: Wanted) -> tuple[str, ...]:
        """Asks for a size first: others depend on it."""
        refused = []
        # in the driver's queue frames only become older
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, wanted.width)
        self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, wanted.height)
        if wanted.exposure is not None:
            self._capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE)
        if wanted.white_balance is not None:
            self._capture.set(cv2.CAP_PROP_AUTO_WB, 0.0)
        for name, what, value in (
            ("fps", cv2.CAP_PROP_FPS, wanted.fps),
            ("exposure", cv2.CAP_PROP_EXPOSURE, wanted.exposure),
            ("gain", cv2.CAP_PROP_GAIN, wanted.gain),
            ("white balance", cv2.CAP_PROP_WB_TEMPERATURE, wanted.white_balance),
        ):
            if value is None:
                continue
            self._capture.set(what, value)
            taken = self._capture.get(what)
            if not math.isclose(taken, value, rel_tol=_CLOSE, abs_tol=_CLOSE):
                refused.append(f"{name} {value:g} (is {taken:g})")
        return tuple(refused)


class Folder:
    """The pictures that a folder has when it is opened, in the order of their names."""

    def __init__(self, device: Device, wanted: Wanted) -> None:
        """Lists them.

        Raises:
            SourceError: there are none.
        """
        self.refused: tuple[str, ...] = ()
        self.fps: float | None = wanted.fps or DEFAULT_FPS
        try:
            self._pictures = pictures_in(Path(device.source))
        except ConfigError as error:
            raise SourceError(str(error)) from error
        if not self._pictures:
            raise SourceError(f"{device.source} has no pictures")
        self._next, self._grabbed = count(), 0

    def size(self) -> tuple[int, int] | None:
        """Of the first picture that can be decoded."""
        first = next((image for file in self._pictures if (image := _read(file)) is not None), None)
        return None if first is None else (first.shape[1], first.shape[0])

    def grab(self) -> bool:
        """Goes on to the next picture."""
        self._grabbed = next(self._next)
        return self._grabbed < len(self._pictures)

    def retrieve(self) -> Image | None:
        """Reads and decodes it."""
        return _read(self._pictures[self._grabbed])

    def close(self) -> None:
        """There is nothing to let go."""


def open_source(device: Device, wanted: Wanted) -> Source:
    """Opens a source.

    Raises:
        SourceError: it can't be opened now.
    """
    return Folder(device, wanted) if device.kind is Kind.FOLDER else CapturedSource(device, wanted)


def rgb8(image: npt.NDArray[Any] | None) -> Image | None:
    """A picture as OpenCV decodes it, (height, width) or (height, width, 3) in blue, green, red, as rgb8.

    Whatever else a driver hands over is none.
    """
    if image is None or image.dtype != np.uint8 or image.size == 0:
        return None
    if image.ndim == 3 and image.shape[2] == 3:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)
    if image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 1):
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2RGB), dtype=np.uint8)
    return None


def _read(file: Path) -> Image | None:
    try:
        # not turned by what its EXIF says: it was calibrated as the sensor has it
        return rgb8(cv2.imread(str(file), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION))
    except cv2.error as error:
        log.warning("a picture can't be decoded", extra={"file": str(file), "reason": str(error)})
        return None
