"""Reading recordings, also those that nobody finished: up to where they can be read, and why not further.

From the first byte to the last, without the index: of a file that a crash ended there is none.
"""

import itertools
import struct
from collections.abc import Collection, Container, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from google.protobuf.message import DecodeError, Message
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Footer, Metadata, Schema
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary

from armsight.errors import ConfigError
from armsight.topics import TOPICS, Topic

_MAGIC = b"\x89MCAP0\r\n"


@dataclass(frozen=True, slots=True)
class Outline:
    """What a recording has, without its messages."""

    channels: dict[str, str]
    """Full name of the message by key, converted channels left out."""
    begin_ns: int
    end_ns: int
    """When the last message came."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One recorded message."""

    key: str
    schema: str
    """Full name of the message."""
    payload: bytes
    log_ns: int
    """When it came, by the recorder's wall clock."""
    instant_ns: int
    """The instant that it tells of; when it came where it tells of none."""
    sequence: int
    converted: bool
    """Whether the recorder made it: it never was on the bus."""
    latched: bool

    def decode(self, message: type[Message]) -> Any:
        """The message.

        Raises:
            DecodeError: the bytes are none.
        """
        result = message()
        result.ParseFromString(self.payload)
        return result


class Recording:
    """A file, or several that follow each other."""

    def __init__(self, *paths: Path) -> None:
        """Takes the files in the order of their names.

        Raises:
            ConfigError: one can't be read, or is no MCAP file.
        """
        self.paths = tuple(sorted(paths))
        self.troubles: dict[Path, str] = {}
        """Why a file ends early, once it has been read."""
        self.notes: dict[str, dict[str, str]] = {}
        """Records of metadata by their names, once read; of several files the last one's."""
        for path in self.paths:
            _check(path)

    def entries(
        self, keys: Container[str] | None = None, begin_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Entry]:
        """Messages in the order in which they came, each once.

        Args:
            keys: of these alone.
            begin_ns: came not before.
            end_ns: came before.
        """
        newest: dict[str, int] = {}
        for path in self.paths:
            for entry in self._read(path, begin_ns, end_ns):
                if (begin_ns is not None and entry.log_ns < begin_ns) or (
                    end_ns is not None and entry.log_ns >= end_ns
                ):
                    continue
                # latched messages stand at the beginning of every file
                if entry.sequence and entry.latched and newest.get(entry.key, 0) >= entry.sequence:
                    continue
                newest[entry.key] = entry.sequence
                if keys is None or entry.key in keys:
                    yield entry

    def messages(self, wanted: Collection[Topic[Any]]) -> Iterator[tuple[Topic[Any], Entry, Any]]:
        """Decoded messages of these rows of the table, in the order in which they came.

        What can't be decoded is left out: it is of somebody else's recorder, ours records no such thing.
        """
        for entry in self.entries():
            topic = topic_of(entry.key)
            if topic is None or topic not in wanted:
                continue
            try:
                message = entry.decode(topic.message)
            except DecodeError:
                continue
            yield topic, entry, message

    def outline(self) -> Outline:
        """From the index where there is one, by reading all of it where there is none."""
        channels: dict[str, str] = {}
        times: list[int] = []
        for path in self.paths:
            summary = _summary(path)
            if summary is None:
                for entry in self._read(path, None, None):
                    times += [entry.log_ns] if not times else []
                    times[1:] = [entry.log_ns]
                    if not entry.converted:
                        channels[entry.key] = entry.schema
                continue
            for channel in summary.channels.values():
                if "converted_from" not in channel.metadata:
                    channels[channel.topic] = summary.schemas[channel.schema_id].name
            if summary.statistics is not None and summary.statistics.message_count:
                times += [summary.statistics.message_start_time, summary.statistics.message_end_time]
        return Outline(channels, min(times, default=0), max(times, default=0))

    def last_before(self, keys: Collection[str], before_ns: int) -> list[Entry]:
        """The last message of each key that came before a time, in the order in which they came."""
        found: dict[str, Entry] = {}
        for path in reversed(self.paths):
            missing = [key for key in keys if key not in found]
            if missing:
                found |= _last_by_index(path, missing, before_ns) or {
                    entry.key: entry
                    for entry in self._read(path, None, before_ns)
                    if entry.key in missing and entry.log_ns < before_ns
                }
        return sorted(found.values(), key=lambda entry: (entry.log_ns, entry.key))

    def _read(self, path: Path, begin_ns: int | None, end_ns: int | None) -> Iterator[Entry]:
        self.troubles.pop(path, None)
        channels: dict[int, tuple[Channel, str]] = {}
        schemas: dict[int, str] = {}
        with path.open("rb") as file:
            size = path.stat().st_size
            ended = False
            # no record is longer than the file, whatever its damaged length says
            reader = StreamReader(file, emit_chunks=True, record_size_limit=size)
            try:
                for record in reader.records:
                    ended = isinstance(record, Footer)
                    if isinstance(record, Metadata):
                        self.notes[record.name] = dict(record.metadata)
                    parts: list[Any] = [record]
                    if isinstance(record, Chunk):
                        is_early = begin_ns is not None and record.message_end_time < begin_ns
                        is_late = end_ns is not None and record.message_start_time >= end_ns
                        # schemas and channels stand in the chunk that needs them first, so none is left out unread
                        parts = [] if is_late else breakup_chunk(record, validate_crc=True)
                        if is_early:
                            parts = [part for part in parts if not isinstance(part, McapMessage)]
                    for part in parts:
                        if isinstance(part, Schema):
                            schemas[part.id] = part.name
                        elif isinstance(part, Channel):
                            channels[part.id] = (part, schemas.get(part.schema_id, ""))
                        elif isinstance(part, McapMessage):
                            yield _entry(part, *channels[part.channel_id])
            except (EndOfFile, struct.error):
                unfinished = f"nobody finished it: it ends after {size} bytes, without its index"
                self.troubles[path] = "its last bytes are missing, and nothing else" if ended else unfinished
            except Exception as error:  # damaged bytes: whatever the decompressors and the library make of them
                self.troubles[path] = f"damaged before byte {file.tell()} of {size}: {_first_line(error)}"


def _summary(path: Path) -> Summary | None:
    """The index at the end of a file; none where there is none, or none that can be read."""
    try:
        with path.open("rb") as file:
            return make_reader(file).get_summary()
    except Exception:  # nobody finished it, or it is damaged: then it is read from the beginning
        return None


def _last_by_index(path: Path, keys: Collection[str], before_ns: int) -> dict[str, Entry]:
    """Nothing where there is no index, or what it points to can't be read."""
    found: dict[str, Entry] = {}
    if _summary(path) is None:
        return found
    try:
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            for key in keys:
                newest = reader.iter_messages([key], ending_before=before_ns, reverse=True)
                for schema, channel, message in itertools.islice(newest, 1):
                    found[key] = _entry(message, channel, schema.name if schema else "")
    except Exception:  # damaged: it is read from the beginning, which says where
        return {}
    return found


@lru_cache(maxsize=1024)
def topic_of(key: str) -> Topic[Any] | None:
    """The row of the table that a recorded key is of; none for what is not armsight's."""
    parts = key.split("/")
    for topic in TOPICS:
        pattern = topic.key.split("/")
        if len(pattern) == len(parts) and all(a in (b, "{name}") for a, b in zip(pattern, parts, strict=True)):
            return topic
    return None


def _entry(message: McapMessage, channel: Channel, schema: str) -> Entry:
    return Entry(
        key=channel.topic,
        schema=schema,
        payload=message.data,
        log_ns=message.log_time,
        instant_ns=message.publish_time,
        sequence=message.sequence,
        converted="converted_from" in channel.metadata,
        latched=channel.metadata.get("delivery") == "latched",
    )


def _check(path: Path) -> None:
    try:
        with path.open("rb") as file:
            begins = file.read(len(_MAGIC))
    except OSError as error:
        raise ConfigError(f"can't read {path}: {error.strerror}") from error
    if not _MAGIC.startswith(begins) and begins != _MAGIC:
        raise ConfigError(f"{path} is no MCAP file")


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]
