"""Pictures of one camera from a folder, a video or a recording, one at a time."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError
from PIL import Image, UnidentifiedImageError

from armsight import topics
from armsight.errors import ConfigError
from armsight.pictures import SUFFIXES, pictures_in
from armsight_operator.picture.draw import picture_of
from armsight_operator.recording.reader import Entry, Recording

Picture = npt.NDArray[np.uint8]
"""Rows x columns x 3: red, green, blue."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One picture, and what a person would call it."""

    name: str
    rgb: Picture


def frames(source: Path, camera: str, every: int = 1) -> Iterator[Frame]:
    """Pictures in their order.

    Args:
        source: a folder of pictures, one picture, an MCAP recording or a video.
        camera: whose pictures, of a recording.
        every: takes each so many-th.

    Raises:
        ConfigError: there are none, one can't be read, or they differ in size.
    """
    size: tuple[int, ...] | None = None
    for frame in _all(source, camera, every):
        if size is None:
            size = frame.rgb.shape
        elif frame.rgb.shape != size:
            raise ConfigError(f"{frame.name} is of another size than {source}'s first picture: one camera at a time")
        yield frame
    if size is None:
        raise ConfigError(f"{source} has no pictures of camera {camera}")


def read_picture(path: Path) -> Picture:
    """One picture.

    Raises:
        ConfigError: it can't be read.
    """
    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB"))
    except (OSError, UnidentifiedImageError) as error:
        raise ConfigError(f"{path} can't be read as a picture: {error}") from error


def decoded(entry: Entry) -> Picture:
    """The picture of a recorded message.

    Raises:
        ConfigError: it is none that we read.
    """
    try:
        message: RawImage = entry.decode(RawImage)
        return np.asarray(picture_of(entry.key.split("/")[1], message))
    except (DecodeError, ValueError) as error:
        raise ConfigError(f"a picture on {entry.key} can't be used: {error}") from error


def _all(source: Path, camera: str, every: int) -> Iterator[Frame]:
    if source.is_dir():
        for path in pictures_in(source)[::every]:
            yield Frame(path.name, read_picture(path))
    elif source.suffix == ".mcap":
        key = topics.CAMERA_IMAGE.key_for(camera)
        for number, entry in enumerate(Recording(source).entries({key})):
            if number % every == 0:
                yield Frame(f"picture {number}", decoded(entry))
    elif source.is_file() and source.suffix.lower() in SUFFIXES:
        yield Frame(source.name, read_picture(source))
    elif source.is_file():
        yield from _video(source, every)
    else:
        raise ConfigError(f"there is no {source}: name a folder of pictures, a video or a recording")


def _video(source: Path, every: int) -> Iterator[Frame]:
    video = cv2.VideoCapture(str(source))
    try:
        if not video.isOpened():
            raise ConfigError(f"{source} can't be read as a video")
        number = 0
        while video.grab():
            if number % every == 0:
                found, picture = video.retrieve()
                if found:
                    yield Frame(f"picture {number}", np.asarray(picture[..., ::-1], dtype=np.uint8))
            number += 1
    finally:
        video.release()
