"""`armsight page` on the bus: a service like the others, which listens to what flows only while somebody looks."""

import logging
import threading
from dataclasses import dataclass

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from armsight import topics
from armsight.bus import Bus, Received
from armsight.service import Context
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.health_pb2 import HEALTH_STATUS_OK
from armsight_operator.page.hand import Hand
from armsight_operator.page.pictures import Pictures
from armsight_operator.page.scene import CameraView, camera_view
from armsight_operator.page.server import Server
from armsight_operator.page.streams import Streams
from armsight_operator.page.view import View

log = logging.getLogger(__name__)

NAME = "page"
"""In `health/{name}`, and who stops the arm."""

_FRAME_S = 1 / 15
_IDLE_S = 0.2
"""How soon a first viewer is noticed."""


@dataclass(frozen=True, slots=True)
class Settings:
    """The configuration in force."""

    host: str
    port: int
    """The one that it got, where it was to take a free one."""


class Described:
    """What sim says once: the arm, and where the cameras stand. Listened to all the time, as it costs nothing."""

    def __init__(self, bus: Bus) -> None:
        """Subscribes."""
        self._lock = threading.Lock()
        self._calibrations: dict[str, CameraCalibration] = {}
        self._poses: dict[str, FrameTransform] = {}
        self._description = bus.subscriber(topics.DESCRIPTION)
        bus.subscriber(topics.CAMERA_CALIBRATION, "*", on_message=self._take_calibration)
        bus.subscriber(topics.CAMERA_POSE, "*", on_message=self._take_pose)

    def arm(self) -> ArmDescription | None:
        """The newest description."""
        received = self._description.latest
        return None if received is None else received.message

    def camera_names(self) -> list[str]:
        """For the keys of their pictures."""
        arm = self.arm()
        return [] if arm is None else sorted(arm.cameras)

    def cameras(self) -> dict[str, CameraView]:
        """Those that are known completely."""
        with self._lock:
            both = {
                name: (self._calibrations[name], pose)
                for name, pose in self._poses.items()
                if name in self._calibrations
            }
        views = {name: camera_view(*pair) for name, pair in both.items()}
        return {name: view for name, view in views.items() if view is not None}

    def _take_calibration(self, received: Received[CameraCalibration]) -> None:
        with self._lock:
            self._calibrations[received.name] = received.message

    def _take_pose(self, received: Received[FrameTransform]) -> None:
        with self._lock:
            self._poses[received.name] = received.message


class Page:
    """The page between the bus and its viewers."""

    def __init__(self, bus: Bus, server: Server, title: str) -> None:
        """Lays out the page."""
        self._bus = bus
        self._server = server
        self._described = Described(bus)
        self._drawn: ArmDescription | None = None
        self._view = View(server.viser, title)
        self._hand = Hand(bus, self._view.say)
        self._view.give_hand(self._hand)
        self._streams: Streams | None = None
        self._pictures: Pictures | None = None

    def run(self, context: Context) -> None:
        """Shows what flows while somebody looks, until the service is asked to stop."""
        context.health.report(HEALTH_STATUS_OK)
        while not context.stop.wait(_FRAME_S if self._streams is not None else _IDLE_S):
            viewers = self._server.viewers
            context.health.gauge("viewers", viewers)
            if viewers and self._streams is None:
                self._streams = Streams(self._bus)
                self._pictures = Pictures(self._bus, self._described.camera_names, self._view.show_picture)
            elif not viewers:
                self._leave_alone()
            if self._streams is not None:
                self._update(self._streams)

    def close(self) -> None:
        """Leaves the bus alone, and ends what asks on it."""
        self._leave_alone()
        self._hand.close()

    def _update(self, streams: Streams) -> None:
        arm = self._described.arm()
        try:
            if arm is not None and arm != self._drawn:
                self._drawn = arm
                self._view.arrange(arm)
            self._view.show_cameras(self._described.cameras())
            self._view.update(streams.seen(), connected=is_connected(self._bus))
        except Exception:  # one message that can't be drawn must not end the page
            log.exception("drawing failed")

    def _leave_alone(self) -> None:
        if self._pictures is not None:
            self._pictures.close()
        if self._streams is not None:
            self._streams.close()
        self._pictures = self._streams = None


def is_connected(bus: Bus) -> bool:
    """Whether there is a router."""
    return bool(bus.session.info.routers_zid())
