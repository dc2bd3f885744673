"""Where pictures come from, as a person names it: `[NAME=]SOURCE`."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from armsight.errors import ConfigError
from armsight.pictures import SUFFIXES, pictures_in
from armsight.topics import NAME

_NAMED = re.compile(r"(?P<name>[A-Za-z0-9_.-]+)=(?P<source>.+)", re.DOTALL)
_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://.+")


class Kind(Enum):
    """What a source is."""

    DEVICE = "device"
    URL = "URL"
    VIDEO = "video"
    FOLDER = "folder"


@dataclass(frozen=True, slots=True)
class Device:
    """One camera on the bus, and where its pictures come from."""

    name: str
    source: str
    """A device's path, a URL, a video file or a folder."""
    kind: Kind

    @property
    def ends(self) -> bool:
        """Whether it has a last picture, and is paced by us."""
        return self.kind in (Kind.VIDEO, Kind.FOLDER)

    def __str__(self) -> str:
        """As a person knows it."""
        return f"camera {self.name} ({self.source})"


def parse_devices(given: Sequence[str]) -> tuple[Device, ...]:
    """The devices of a command line; those without a name are called by their places, from 1.

    Raises:
        ConfigError: none, a name that can't be one or is there twice, a source that is nothing that is known.
    """
    if not given:
        raise ConfigError("say where pictures come from: --device 0, --device /dev/video0, a URL, a video or a folder")
    devices = tuple(_readable(text, place) for place, text in enumerate(given, 1))
    names = [device.name for device in devices]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ConfigError(f"two devices are called {twice[0]}: give each a name of its own, --device NAME=SOURCE")
    return devices


def _readable(text: str, place: int) -> Device:
    try:
        return _device(text, place)
    except OSError as error:
        raise ConfigError(f"--device {text} can't be read: {error.strerror}") from error


def _device(text: str, place: int) -> Device:
    # a URL may have an equals sign as well, and a file that is there is that file
    named = None if _URL.fullmatch(text) or Path(text).exists() else _NAMED.fullmatch(text)
    name, source = (named["name"], named["source"]) if named else (str(place), text)
    if not NAME.fullmatch(name):
        raise ConfigError(f"--device {text}: a camera's name is up to 64 letters, digits, _, - and .")
    return Device(name, *_source(source))


def _source(source: str) -> tuple[str, Kind]:
    if source.isascii() and source.isdigit():
        return f"/dev/video{int(source)}", Kind.DEVICE
    if source.startswith("/dev/"):
        return source, Kind.DEVICE
    if _URL.fullmatch(source):
        return source, Kind.URL
    path = Path(source)
    if path.is_dir():
        if not pictures_in(path):
            raise ConfigError(f"--device {source}: the folder has no pictures ({', '.join(sorted(SUFFIXES))})")
        return source, Kind.FOLDER
    if path.is_file():
        return source, Kind.VIDEO
    raise ConfigError(
        f"--device {source}: no such file or folder; a number or /dev/video… is a device, and a URL has :// in it"
    )
