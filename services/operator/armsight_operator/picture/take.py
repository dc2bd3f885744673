"""Taking the frames and annotations of one instant off the bus, and leaving it alone again."""

import time
from collections.abc import Mapping

from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from armsight import topics
from armsight.bus import Bus, Received, Subscriber
from armsight.times import from_timestamp
from armsight_operator.errors import NoDataError
from armsight_operator.picture.draw import View

_KEEP = 64


def take_views(bus: Bus, timeout_s: float = 5.0) -> list[View]:
    """The newest instant of which every camera's frame and annotations are there, by camera name.

    Annotations and frames are only listened to meanwhile: nobody who looks, no traffic.

    Raises:
        NoDataError: none within the time.
    """
    until = time.monotonic() + timeout_s
    frames: dict[int, dict[str, RawImage]] = {}
    notes: dict[int, dict[str, ImageAnnotations]] = {}

    def keep_note(received: Received[ImageAnnotations]) -> None:
        stamps = [from_timestamp(text.timestamp) for text in received.message.texts]
        if stamps:
            notes.setdefault(stamps[0], {})[received.name] = received.message

    def keep_frame(received: Received[RawImage]) -> None:
        frames.setdefault(from_timestamp(received.message.timestamp), {})[received.name] = received.message

    description = bus.subscriber(topics.DESCRIPTION)
    annotations = bus.subscriber(topics.CAMERA_ANNOTATIONS, "*", keep=_KEEP, on_message=keep_note)
    images: Subscriber[RawImage] | None = None
    try:
        arm = description.recv(timeout_s)
        if arm is None:
            raise NoDataError("no description of the arm: is sim running?")
        cameras = sorted(arm.message.cameras)
        while time.monotonic() < until:
            if images is None and notes:  # vision has noticed that somebody listens
                images = bus.subscriber(topics.CAMERA_IMAGE, "*", keep=_KEEP, on_message=keep_frame)
            complete = [stamp for stamp in list(frames) if _is_complete(stamp, cameras, frames, notes)]
            if complete:
                newest = max(complete)
                return [View(name, frames[newest][name], notes[newest][name]) for name in cameras]
            for old in sorted(frames)[:-4]:
                frames.pop(old, None)
            time.sleep(0.01)
    finally:
        description.close()
        annotations.close()
        if images is not None:
            images.close()
    raise NoDataError(f"no annotated frames of all cameras within {timeout_s:g} s: are sim and vision running?")


def _is_complete(
    stamp: int,
    cameras: list[str],
    frames: Mapping[int, Mapping[str, RawImage]],
    notes: Mapping[int, Mapping[str, ImageAnnotations]],
) -> bool:
    return all(name in frames.get(stamp, {}) and name in notes.get(stamp, {}) for name in cameras)
