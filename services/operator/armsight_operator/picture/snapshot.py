"""One instant as files: what `armsight-vision --calibration … --image …` measures without a bus."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import Message

from armsight import topics
from armsight.bus import Bus, Received
from armsight.calibration import CalibrationFile, KnownCamera, write_calibration_file
from armsight.times import from_timestamp
from armsight.topics import Topic
from armsight.v1.description_pb2 import ArmDescription
from armsight_operator.errors import NoDataError
from armsight_operator.picture.draw import picture_of

CALIBRATION = "calibration.json"

M = TypeVar("M", bound=Message)


@dataclass(frozen=True, slots=True)
class CameraSnapshot:
    """One camera, and its frame."""

    calibration: CameraCalibration
    pose: FrameTransform
    image: RawImage


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What vision gets for one instant."""

    capture_ns: int
    description: ArmDescription
    cameras: Mapping[str, CameraSnapshot]


def _latched(bus: Bus, topic: Topic[M], name: str, until: float) -> M:
    subscriber = bus.subscriber(topic, name)
    try:
        received = subscriber.recv(max(0.0, until - time.monotonic()))
    finally:
        subscriber.close()
    if received is None:
        raise NoDataError(f"nothing on {topic.key_for(name)}: is sim running?")
    return received.message


def take_snapshot(bus: Bus, timeout_s: float = 5.0) -> Snapshot:
    """The next instant of which every camera's frame is there.

    Raises:
        NoDataError: none within the time.
    """
    until = time.monotonic() + timeout_s
    frames: dict[int, dict[str, RawImage]] = {}

    def keep(received: Received[RawImage]) -> None:
        frames.setdefault(from_timestamp(received.message.timestamp), {})[received.name] = received.message

    description = bus.subscriber(topics.DESCRIPTION)
    images = bus.subscriber(topics.CAMERA_IMAGE, "*", on_message=keep)
    try:
        arm = description.recv(timeout_s)
        if arm is None:
            raise NoDataError("no description of the arm: is sim running?")
        names = sorted(arm.message.cameras)
        cameras = {
            name: (
                _latched(bus, topics.CAMERA_CALIBRATION, name, until),
                _latched(bus, topics.CAMERA_POSE, name, until),
            )
            for name in names
        }
        while time.monotonic() < until:
            for capture_ns, seen in sorted(frames.copy().items()):
                if all(name in seen for name in names):
                    return Snapshot(
                        capture_ns,
                        arm.message,
                        {name: CameraSnapshot(*cameras[name], seen[name]) for name in names},
                    )
            time.sleep(0.01)
    finally:
        description.close()
        images.close()
    raise NoDataError(f"no frames of all cameras within {timeout_s:g} s: is sim running?")


def write_snapshot(snapshot: Snapshot, folder: Path) -> dict[str, Path]:
    """Writes ``calibration.json`` and a PNG file for each camera.

    Returns:
        The pictures by camera.

    Raises:
        OSError: the folder can't be made, or a picture not written.
        ConfigError: the calibration can't be written.
        ValueError: a frame is not rgb8, or its data do not fill it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    cameras = {name: KnownCamera(camera.calibration, camera.pose) for name, camera in snapshot.cameras.items()}
    write_calibration_file(folder / CALIBRATION, CalibrationFile(cameras, description=snapshot.description))
    pictures = {name: folder / f"camera-{name}.png" for name in snapshot.cameras}
    for name, camera in snapshot.cameras.items():
        picture_of(name, camera.image).save(pictures[name])
    return pictures
