"""A vision as somebody could bring one: centroids of colours on two rays. Broken by overriding a method."""

import threading
import time
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from armsight import topics
from armsight.bus import Bus, Received
from armsight.parameters import Tunable
from armsight.service import HealthReporter, serve_parameters
from armsight.times import from_timestamp, to_duration, to_timestamp, wall_ns
from armsight.v1.description_pb2 import ArmDescription, Marker
from armsight.v1.health_pb2 import HEALTH_STATUS_OK
from armsight.v1.joints_pb2 import (
    MARKER_STATUS_LOST,
    MARKER_STATUS_ONE_VIEW,
    MARKER_STATUS_TRACKED,
    CameraObservation,
    JointPositions,
    MarkerPosition,
)

Array = npt.NDArray[np.float64]
PATIENCE_S = 0.3
LEAST_PIXELS = 8


class OwnVision:
    """Knows cameras and markers from the bus, and nothing else."""

    service: ClassVar[str] = "vision"

    def __init__(self, bus: Bus) -> None:
        self.bus, self.lock = bus, threading.RLock()
        self.description: ArmDescription | None = None
        self.calibrations: dict[str, CameraCalibration] = {}
        self.poses: dict[str, tuple[Array, Array]] = {}
        self.waiting: dict[int, tuple[float, dict[str, RawImage]]] = {}
        self.last: dict[str, tuple[int, Array]] = {}
        self.looked_at: dict[int, tuple[Array, Array, Array]] = {}
        self.declare_parameters()
        self.health: Any = self.new_health()
        self.out = bus.publisher(topics.JOINT_POSITIONS)
        self.annotations = {name: bus.publisher(topics.CAMERA_ANNOTATIONS, name) for name in ("1", "2")}
        bus.subscriber(topics.DESCRIPTION, on_message=lambda got: self.describe(got.message))
        bus.subscriber(topics.CAMERA_CALIBRATION, "*", on_message=self.calibrate)
        bus.subscriber(topics.CAMERA_POSE, "*", on_message=self.place)
        for name in ("1", "2"):
            bus.subscriber(topics.CAMERA_IMAGE, name, keep=8, on_message=self.image)
        self.thread = threading.Thread(target=self.loop, daemon=True)
        self.thread.start()

    def new_health(self) -> Any:
        health = HealthReporter(self.service, self.bus)
        health.report(HEALTH_STATUS_OK)
        return health

    def declare_parameters(self) -> None:
        tunables = (Tunable("least_pixels", "of a marker", LEAST_PIXELS, "px", 1, 100),)
        serve_parameters(self.service, self.bus, {}).declare(tunables, lambda _: None)

    # --- what it hears

    def describe(self, message: ArmDescription) -> None:
        if message.markers:
            self.description = message
        else:
            self.bus.counters.add("description_refused")

    def calibrate(self, got: Received[CameraCalibration]) -> None:
        if len(got.message.K) == 9:
            self.calibrations[got.name] = got.message
        else:
            self.bus.counters.add("calibration_refused")

    def place(self, got: Received[FrameTransform]) -> None:
        q, t = got.message.rotation, got.message.translation
        if abs(q.w**2 + q.x**2 + q.y**2 + q.z**2 - 1) > 1e-6:
            self.bus.counters.add("pose_refused")
            return
        x = np.array([[0.0, -q.z, q.y], [q.z, 0.0, -q.x], [-q.y, q.x, 0.0]])
        turned = np.eye(3) + 2 * q.w * x + 2 * x @ x
        self.poses[got.name] = turned, np.array([t.x, t.y, t.z])

    def image(self, got: Received[RawImage]) -> None:
        image = got.message
        if not self.usable(got.name, image):
            self.bus.counters.add("image_refused")
            return
        with self.lock:
            _, frames = self.waiting.setdefault(from_timestamp(image.timestamp), (time.monotonic(), {}))
            frames[got.name] = image

    def usable(self, camera: str, image: RawImage) -> bool:
        size = self.calibrations.get(camera)
        fits = size is None or (image.width, image.height) == (size.width, size.height)
        whole = image.step == 3 * image.width and len(image.data) == image.step * image.height
        return fits and whole and image.width > 0 and image.encoding == "rgb8"

    def loop(self) -> None:
        while True:  # a daemon: it ends with the test
            time.sleep(0.002)
            with self.lock:
                due = next((at for at in sorted(self.waiting) if self.complete(*self.waiting[at])), None)
                if due is None:
                    continue
                _, frames = self.waiting.pop(due)
            self.instant(due, frames)

    def complete(self, since_s: float, frames: dict[str, RawImage]) -> bool:
        return len(frames) == 2 or time.monotonic() - since_s > PATIENCE_S

    # --- what it makes of it

    def instant(self, capture_ns: int, frames: dict[str, RawImage]) -> None:
        if self.description is None or set(self.poses) != {"1", "2"} or len(self.calibrations) != 2:
            return
        received_ns = wall_ns()
        self.looked_at.clear()
        found = JointPositions(capture_time=to_timestamp(capture_ns))
        for marker in self.description.markers:
            found.markers.append(self.marker(marker, frames, capture_ns))
        found.stages.frames_sent_ns, found.stages.vision_received_ns = received_ns - 1000, received_ns
        found.stages.vision_sent_ns = wall_ns()
        self.send(found)
        self.annotate()

    def marker(self, marker: Marker, frames: dict[str, RawImage], capture_ns: int) -> MarkerPosition:
        told = MarkerPosition(name=marker.name)
        rays = []
        for camera, image in sorted(frames.items()):
            seen = self.seen(marker, image)
            if seen is None:
                continue
            u, v = seen
            told.observations.append(CameraObservation(camera=camera, u_px=u, v_px=v, visible=1.0))
            k, (rotation, centre) = self.calibrations[camera].K, self.poses[camera]
            ray = rotation @ np.array([(u - k[2]) / k[0], (v - k[5]) / k[4], 1.0])
            rays.append((centre, ray / np.linalg.norm(ray)))
        if len(rays) == 2:
            told.status, position, sigma = MARKER_STATUS_TRACKED, _nearest(rays), 0.02
        elif rays and marker.name in self.last:
            told.status, (centre, ray), sigma = MARKER_STATUS_ONE_VIEW, rays[0], self.one_view_sigma()
            position = centre + ray * (ray @ (self.last[marker.name][1] - centre))
        else:
            return self.lost(told, capture_ns)
        self.last[marker.name] = capture_ns, position
        told.position.x, told.position.y, told.position.z = position
        told.covariance.extend((np.eye(3) * sigma**2).ravel())
        return told

    def one_view_sigma(self) -> float:
        return 1.0

    def lost(self, told: MarkerPosition, capture_ns: int) -> MarkerPosition:
        told.status = MARKER_STATUS_LOST
        if told.name in self.last:
            seen_ns, position = self.last[told.name]
            told.age.CopyFrom(to_duration((capture_ns - seen_ns) / 1e9))
            told.position.x, told.position.y, told.position.z = position
            told.covariance.extend(np.eye(3).ravel())
        return told

    def seen(self, marker: Marker, image: RawImage) -> tuple[float, float] | None:
        """Of the colour: the middle of its outline."""
        u, v, chroma = self.colored(image)
        color = np.array([marker.color.red, marker.color.green, marker.color.blue])
        like = np.abs(chroma - color / color.max()).max(axis=1) < 0.4
        if like.sum() < LEAST_PIXELS:
            return None
        return float(u[like].mean()), float(v[like].mean())

    def colored(self, image: RawImage) -> tuple[Array, Array, Array]:
        """Columns, rows and chromaticity of all pixels that are not grey; once for all markers of an image."""
        if id(image) not in self.looked_at:
            pixels = np.frombuffer(image.data, np.uint8).reshape(image.height, image.width, 3)
            red, green, blue = pixels[..., 0], pixels[..., 1], pixels[..., 2]
            light = np.maximum(np.maximum(red, green), blue)
            grey = np.minimum(np.minimum(red, green), blue)
            v, u = np.nonzero((light > 60) & (grey < light // 2))
            chroma = pixels[v, u] / light[v, u][:, None]
            self.looked_at[id(image)] = u.astype(np.float64), v.astype(np.float64), chroma
        return self.looked_at[id(image)]

    # --- what it says

    def send(self, found: JointPositions) -> None:
        self.out.put(found)

    def annotate(self) -> None:
        for publisher in self.annotations.values():
            if publisher.has_subscribers():
                publisher.put(ImageAnnotations())


def _nearest(rays: list[tuple[Array, Array]]) -> Array:
    """The point with the least squared distance from all rays."""
    across = [np.eye(3) - np.outer(ray, ray) for _, ray in rays]
    return np.asarray(
        np.linalg.solve(sum(across), sum(a @ centre for a, (centre, _) in zip(across, rays, strict=True)))
    )
