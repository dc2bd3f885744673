"""Frames from a recording, by when the recorder heard of them."""

from collections.abc import Iterator

from google.protobuf.message import DecodeError

from armsight_operator.recording.reader import Recording, topic_of
from armsight_operator.trace.stages import KEYS, Frame, Joiner


def recorded_frames(recording: Recording) -> Iterator[Frame]:
    """Every frame of a recording whose answer is in it, in the order of the answers."""
    joiner = Joiner()
    for entry in recording.entries({topic.key for topic in KEYS}):
        topic = topic_of(entry.key)
        if topic is None:
            continue
        try:
            message = entry.decode(topic.message)
        except DecodeError:  # of somebody else's recorder: ours leaves out what can't be decoded
            continue
        if (frame := joiner.take(message, entry.log_ns)) is not None:
            yield frame
    if (frame := joiner.rest()) is not None:
        yield frame
