"""Taking the frames and annotations of one instant off the bus, and leaving it alone again."""

import time
from collections.abc import Sequence

from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from armsight import topics
from armsight.bus import Bus, Received
from armsight.times import from_timestamp
from armsight_operator.errors import NoDataError
from armsight_operator.picture.draw import View

_KEEP = 64
"""Samples that may wait; instants whose annotations are remembered."""
_KEEP_INSTANTS = 4
"""Whose frames are remembered: they are large."""


class Views:
    """Instants one at a time: annotations are listened to until :meth:`close`, frames only while one is taken."""

    def __init__(self, bus: Bus) -> None:
        """Listens to annotations: vision notices within half a second."""
        self._bus = bus
        self._frames: dict[int, dict[str, RawImage]] = {}
        self._notes: dict[int, dict[str, ImageAnnotations]] = {}
        self._annotations = bus.subscriber(topics.CAMERA_ANNOTATIONS, "*", keep=_KEEP, on_message=self._keep_note)

    def take(self, cameras: Sequence[str], timeout_s: float, bare_after_s: float | None = None) -> list[View]:
        """The newest instant of which every camera's frame and annotations are there.

        Args:
            cameras: their names.
            timeout_s: how long to wait for one.
            bare_after_s: then frames without annotations will do (default: never).

        Raises:
            NoDataError: none within the time.
        """
        began = time.monotonic()
        self._frames.clear()
        images = None
        try:
            while (passed_s := time.monotonic() - began) < timeout_s:
                bare = bare_after_s is not None and passed_s >= bare_after_s
                # before vision has noticed that somebody listens, there would be only frames
                if images is None and (self._notes or bare_after_s is not None):
                    images = self._bus.subscriber(topics.CAMERA_IMAGE, "*", keep=_KEEP, on_message=self._keep_frame)
                complete = [stamp for stamp in list(self._frames) if self._is_complete(stamp, cameras, bare=bare)]
                if complete:
                    newest = max(complete)
                    frames, notes = self._frames[newest], self._notes.get(newest, {})
                    return [View(name, frames[name], notes.get(name)) for name in cameras]
                time.sleep(0.01)
        finally:
            if images is not None:
                images.close()
            self._frames.clear()
        raise NoDataError(f"no annotated frames of all cameras within {timeout_s:g} s: are sim and vision running?")

    def close(self) -> None:
        """Leaves the bus alone again."""
        self._annotations.close()

    def _keep_note(self, received: Received[ImageAnnotations]) -> None:
        stamps = [from_timestamp(text.timestamp) for text in received.message.texts]
        if stamps:
            self._notes.setdefault(stamps[0], {})[received.name] = received.message
            for old in sorted(self._notes)[:-_KEEP]:
                self._notes.pop(old, None)

    def _keep_frame(self, received: Received[RawImage]) -> None:
        self._frames.setdefault(from_timestamp(received.message.timestamp), {})[received.name] = received.message
        for old in sorted(self._frames)[:-_KEEP_INSTANTS]:
            self._frames.pop(old, None)

    def _is_complete(self, stamp: int, cameras: Sequence[str], *, bare: bool) -> bool:
        frames, notes = self._frames.get(stamp, {}), self._notes.get(stamp, {})
        return all(name in frames and (bare or name in notes) for name in cameras)


def take_views(bus: Bus, timeout_s: float = 5.0) -> list[View]:
    """The newest instant of which every camera's frame and annotations are there, by camera name.

    Annotations and frames are only listened to meanwhile: nobody who looks, no traffic.

    Raises:
        NoDataError: none within the time.
    """
    description = bus.subscriber(topics.DESCRIPTION)
    views = Views(bus)
    try:
        arm = description.recv(timeout_s)
        if arm is None:
            raise NoDataError("no description of the arm: is sim running?")
        return views.take(sorted(arm.message.cameras), timeout_s)
    finally:
        description.close()
        views.close()
