"""What a recording has in it, and whether it is whole."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from armsight_operator.recording.reader import Recording


@dataclass(slots=True)
class KeyInfo:
    """One key, or one converted channel."""

    message: str
    converted: bool
    count: int = 0
    bytes: int = 0
    first_ns: int = 0
    last_ns: int = 0
    first_sequence: int = 0
    last_sequence: int = 0

    @property
    def lost(self) -> int:
        """Messages that the recorder had no room for, by the numbers that are missing."""
        return 0 if self.converted else self.last_sequence - self.first_sequence + 1 - self.count

    @property
    def rate_hz(self) -> float:
        """Of what is there."""
        seconds = (self.last_ns - self.first_ns) / 1e9
        return (self.count - 1) / seconds if seconds > 0 else 0.0


@dataclass(slots=True)
class Info:
    """A whole recording."""

    files: tuple[Path, ...]
    bytes: int
    keys: dict[str, KeyInfo] = field(default_factory=dict)
    begin_ns: int = 0
    end_ns: int = 0
    troubles: Mapping[Path, str] = field(default_factory=dict)
    notes: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    @property
    def complete(self) -> bool:
        """Whether every file was finished and read to its end."""
        return not self.troubles

    @property
    def seconds(self) -> float:
        """From the first message to the last."""
        return (self.end_ns - self.begin_ns) / 1e9

    @property
    def messages(self) -> int:
        """That were on the bus."""
        return sum(key.count for key in self.keys.values() if not key.converted)

    @property
    def lost(self) -> int:
        """Of all keys."""
        return sum(key.lost for key in self.keys.values())

    def as_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "files": [str(path) for path in self.files],
            "bytes": self.bytes,
            "complete": self.complete,
            "troubles": {str(path): text for path, text in self.troubles.items()},
            "begin_ns": self.begin_ns,
            "end_ns": self.end_ns,
            "messages": self.messages,
            "lost": self.lost,
            "keys": {name: asdict(key) | {"lost": key.lost} for name, key in sorted(self.keys.items())},
            "notes": {name: dict(note) for name, note in self.notes.items()},
        }


def info_of(recording: Recording) -> Info:
    """Reads all of it."""
    info = Info(recording.paths, sum(path.stat().st_size for path in recording.paths))
    for entry in recording.entries():
        key = info.keys.get(entry.key)
        if key is None:
            key = info.keys[entry.key] = KeyInfo(
                entry.schema, entry.converted, first_ns=entry.log_ns, first_sequence=entry.sequence
            )
        key.count += 1
        key.bytes += len(entry.payload)
        key.last_ns, key.last_sequence = entry.log_ns, entry.sequence
        info.begin_ns = info.begin_ns or entry.log_ns
        info.end_ns = entry.log_ns
    info.troubles, info.notes = dict(recording.troubles), dict(recording.notes)
    return info
