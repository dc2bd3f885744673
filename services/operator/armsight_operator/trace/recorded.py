"""Frames from a recording, by when the recorder heard of them."""

from collections.abc import Iterator

from armsight_operator.recording.reader import Recording
from armsight_operator.trace.stages import KEYS, Frame, Joiner


def recorded_frames(recording: Recording) -> Iterator[Frame]:
    """Every frame of a recording whose answer is in it, in the order of the answers."""
    joiner = Joiner()
    for _, entry, message in recording.messages(KEYS):
        if (frame := joiner.take(message, entry.log_ns)) is not None:
            yield frame
    if (frame := joiner.rest()) is not None:
        yield frame
