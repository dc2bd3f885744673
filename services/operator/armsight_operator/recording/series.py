"""A recording as files, one after the other, each of which can be opened alone."""

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from google.protobuf.message import DecodeError, Message

from armsight.counters import Counters
from armsight.errors import ConfigError
from armsight_operator.errors import OperatorError
from armsight_operator.recording.backlog import Arrival
from armsight_operator.recording.instants import instant_of
from armsight_operator.recording.mcap_file import McapFile
from armsight_operator.recording.scene import MESSAGES, SOURCES, Scene

SUFFIX = ".mcap"


class FullError(OperatorError):
    """There is no room left to record to."""


@dataclass(frozen=True, slots=True)
class Limits:
    """When to go on in another file; none: never."""

    bytes: int | None = None
    seconds: float | None = None

    @property
    def any(self) -> bool:
        """Whether there will be several files."""
        return self.bytes is not None or self.seconds is not None


@dataclass(slots=True)
class Totals:
    """What was written, over all files."""

    messages: Counter[str] = field(default_factory=Counter)
    """By key, without what was repeated or converted."""
    bytes: int = 0
    """Of the files that are finished."""
    files: list[Path] = field(default_factory=list)


class Series:
    """Writes messages to a file and, where a limit is reached, to the next."""

    def __init__(
        self,
        path: Path,
        limits: Limits,
        metadata: Mapping[str, str],
        compression: str = "zstd",
        *,
        overwrite: bool = False,
        counters: Counters | None = None,
    ) -> None:
        """Opens the first file.

        Args:
            path: a file to make, or a folder in which it is named by the time.
            limits: of one file.
            metadata: told at the beginning of each.
            compression: one of :data:`~armsight_operator.recording.mcap_file.COMPRESSIONS`.
            overwrite: whether files that are there are replaced.
            counters: where malformed messages are counted.

        Raises:
            ConfigError: the file is there already, or can't be made.
        """
        self._path = _named_by_time(path) if path.is_dir() else path
        self._limits, self._metadata, self._compression = limits, dict(metadata), compression
        self._overwrite = overwrite
        self._counters = counters or Counters()
        self._scene = Scene()
        self._converted: Counter[str] = Counter()
        self._latched: dict[str, tuple[Arrival, Message]] = {}
        self._began_ns: int | None = None
        self._last_ns = 0
        self.totals = Totals()
        self._file = self._open()

    @property
    def path(self) -> Path:
        """Of the file that is written now."""
        return self._file.path

    @property
    def bytes(self) -> int:
        """Of all files by now."""
        return self.totals.bytes + self._file.size

    @property
    def last_ns(self) -> int:
        """When the last message came that is in the files."""
        return self._last_ns

    def write(self, arrival: Arrival) -> Message | None:
        """Adds a message and what is converted from it; returns it decoded, or nothing where it is malformed.

        Raises:
            FullError: no room. What came before is in the files, which are finished.
        """
        topic = arrival.sample.topic
        message: Message = topic.message()
        try:
            message.ParseFromString(arrival.sample.payload)
        except DecodeError:
            self._counters.add(f"malformed_{topic.name}")
            return None
        try:
            if self._is_over(arrival):
                self._next(arrival.at_ns)
            self._put(arrival, message, arrival.at_ns)
        except OSError as error:
            raise self._full(error) from error
        if topic.delivery == "latched":
            self._latched[arrival.sample.key] = (arrival, message)
        self.totals.messages[arrival.sample.key] += 1
        return message

    def flush(self) -> None:
        """Puts what was gathered where a crash does not reach it.

        Raises:
            FullError: no room for it.
        """
        try:
            self._file.flush()
        except OSError as error:
            raise self._full(error) from error

    def finish(self, why: str, lost: Mapping[str, int]) -> None:
        """Ends the last file.

        Raises:
            FullError: no room for its end.
        """
        try:
            self._finish_file(why, lost)
        except OSError as error:
            raise FullError(
                f"{self._file.path} can't be ended ({error.strerror}): it is readable without index"
            ) from error

    def _put(self, arrival: Arrival, message: Message, at_ns: int) -> None:
        sample, instant = arrival.sample, instant_of(message)
        times = (at_ns, at_ns if instant is None else instant)
        metadata = {"delivery": sample.topic.delivery}
        self._file.write(sample.key, sample.topic.message, sample.payload, times, arrival.sequence, metadata)
        if self._began_ns is None:
            self._began_ns = at_ns
        self._last_ns = at_ns
        converted = self._scene.convert(sample.topic, message)
        if converted is not None:
            channel = converted.channel
            self._converted[channel] += 1
            self._file.write(
                channel,
                MESSAGES[channel],
                converted.message.SerializeToString(),
                times,
                self._converted[channel],
                {"converted_from": SOURCES[channel]},
            )

    def _is_over(self, arrival: Arrival) -> bool:
        if self._began_ns is None:
            return False
        limits = self._limits
        too_large = limits.bytes is not None and self._file.size + len(arrival.sample.payload) > limits.bytes
        return too_large or (limits.seconds is not None and arrival.at_ns - self._began_ns >= limits.seconds * 1e9)

    def _next(self, at_ns: int) -> None:
        self._finish_file("goes on in the next file", {})
        self._file = self._open()
        self._began_ns = at_ns
        for arrival, message in self._latched.values():
            self._put(arrival, message, at_ns)

    def _open(self) -> McapFile:
        number = len(self.totals.files) + 1
        path = self._path
        if self._limits.any:
            path = path.with_name(f"{path.stem}-{number:03d}{path.suffix}")
        about = self._metadata | {"file": str(number)}
        try:
            return McapFile(path, about, self._compression, overwrite=self._overwrite)
        except FileExistsError as error:
            raise ConfigError(
                f"{path} is there already: choose another name, or replace it with --overwrite"
            ) from error
        except OSError as error:
            raise ConfigError(f"can't write to {path}: {error.strerror}") from error

    def _finish_file(self, why: str, lost: Mapping[str, int]) -> None:
        path = self._file.path
        try:
            self._file.finish({"why": why, **{f"lost {key}": str(count) for key, count in sorted(lost.items())}})
        finally:
            self.totals.files.append(path)
            self.totals.bytes += path.stat().st_size

    def _full(self, error: OSError) -> FullError:
        path = self._file.path
        ended = ""
        try:
            self._finish_file("no room", {})
        except OSError:
            ended = ", without its index"
        until = time.strftime("%H:%M:%S", time.localtime(self._last_ns / 1e9))
        return FullError(
            f"can't go on writing to {path} ({error.strerror}): all until {until} is in it and readable{ended}; "
            "free some space, or record to another disk"
        )


def _named_by_time(folder: Path) -> Path:
    return folder / time.strftime(f"armsight-%Y%m%dT%H%M%SZ{SUFFIX}", time.gmtime())
