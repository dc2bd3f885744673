"""What is known of cameras and of the markers' colours, as a file: `calibration.json`.

One JSON object:

``cameras``
    by name ``{"calibration": …, "pose": …}``: foxglove.CameraCalibration and foxglove.FrameTransform in
    protobuf's JSON. Either may be missing where it is not known yet.
``colours``
    by marker ``{"red": …, "green": …, "blue": …}``: an armsight.v1.Color. May be missing.
``description``
    the armsight.v1.ArmDescription, for those who measure without a bus. May be missing.

`armsight snapshot` writes it, `armsight calibrate` fills it, and `armsight-camera`, `armsight-sim --calibration` and
`armsight-vision --calibration` read it.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from google.protobuf.json_format import MessageToDict, ParseDict, ParseError
from google.protobuf.message import Message

from armsight.errors import ConfigError
from armsight.v1.description_pb2 import ArmDescription, Color

M = TypeVar("M", bound=Message)

PLUMB_BOB = "plumb_bob"
"""The one model of distortion: k1, k2, p1, p2, k3."""

_WORLD = "world"
_MOST_OFF_UNIT = 1e-3
"""Of a quaternion's norm; vision refuses more."""
_PARTS = frozenset({"cameras", "colours", "description"})
_CAMERA_PARTS = frozenset({"calibration", "pose"})


@dataclass(frozen=True, slots=True)
class KnownCamera:
    """What is known of one camera; none: not known yet."""

    calibration: CameraCalibration | None = None
    """Size, focal lengths, principal point and distortion, by OpenCV's convention: integer pixel centres."""
    pose: FrameTransform | None = None
    """T_world_camera: x right, y down, z into the scene."""


@dataclass(frozen=True, slots=True)
class CalibrationFile:
    """The content of one file."""

    cameras: Mapping[str, KnownCamera] = field(default_factory=dict)
    colours: Mapping[str, Color] = field(default_factory=dict)
    """Linear RGB by marker."""
    description: ArmDescription | None = None


def read_calibration_file(path: Path) -> CalibrationFile:
    """What a file says; of numbers it is only known that they are numbers.

    Raises:
        ConfigError: it can't be read, is not JSON, or holds what does not belong there.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path} can't be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # no UTF-8, no JSON, or a number that is too long
        raise ConfigError(f"{path} is not JSON: {error}") from error
    try:
        return _parsed(content)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def write_calibration_file(path: Path, content: CalibrationFile) -> None:
    """Writes a file, or replaces it: whoever reads meanwhile gets the old one or the new one, never half of it.

    Raises:
        ConfigError: it can't be written.
    """
    whole: dict[str, object] = {}
    if content.description is not None:
        whole["description"] = MessageToDict(content.description)
    whole["cameras"] = {name: _camera_dict(camera) for name, camera in content.cameras.items()}
    if content.colours:
        whole["colours"] = {name: MessageToDict(colour) for name, colour in content.colours.items()}
    partial = path.with_name(path.name + ".part")
    try:
        partial.write_text(json.dumps(whole, indent=2) + "\n", encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        raise ConfigError(f"{path} can't be written: {error.strerror}") from error


def optical_frame(camera: str) -> str:
    """Name of a camera's optical frame on the bus."""
    return f"camera_{camera}_optical"


def checked_lens(message: CameraCalibration, camera: str) -> CameraCalibration:
    """A calibration that vision can use, by the names of the bus whatever its maker calls the frame.

    Raises:
        ConfigError: it has no size, not the 9 numbers of K, a focal length that is not above 0, or another lens' D.
    """
    k, d = message.K, message.D
    if not (message.width and message.height) or len(k) != 9:
        wrong = "has no size or not the 9 numbers of K"
    elif not all(map(math.isfinite, (*k, *d))) or min(k[0], k[4]) <= 0:
        wrong = "has a focal length that is not above 0, or a number that is not finite"
    elif len(d) > 5 or (any(d) and message.distortion_model != PLUMB_BOB):
        wrong = f"is of a lens of another kind than {PLUMB_BOB} with at most 5 numbers of D"
    else:
        result = CameraCalibration()
        result.CopyFrom(message)
        result.frame_id = optical_frame(camera)
        return result
    raise ConfigError(f"the calibration of camera {camera} {wrong}: `armsight calibrate intrinsics` makes it anew")


def checked_pose(message: FrameTransform, camera: str) -> FrameTransform:
    """A pose that vision can use, by the names of the bus; without a parent it is taken for one in the world.

    Raises:
        ConfigError: it is in another frame than the world, its rotation is none, or its place is not finite.
    """
    rotation, place = message.rotation, message.translation
    norm = math.hypot(rotation.w, rotation.x, rotation.y, rotation.z)
    if message.parent_frame_id not in ("", _WORLD):
        wrong = f"is in the frame {message.parent_frame_id!r} instead of {_WORLD!r}"
    elif not abs(norm - 1) < _MOST_OFF_UNIT:
        wrong = "has a rotation that is no unit quaternion"
    elif not all(map(math.isfinite, (place.x, place.y, place.z))):
        wrong = "has a place that is not finite"
    else:
        result = FrameTransform()
        result.CopyFrom(message)
        result.parent_frame_id, result.child_frame_id = _WORLD, optical_frame(camera)
        return result
    raise ConfigError(f"the pose of camera {camera} {wrong}: `armsight calibrate extrinsics` makes it anew")


def recoloured(arm: ArmDescription, content: CalibrationFile) -> ArmDescription:
    """The description with the file's colours for its markers."""
    result = ArmDescription()
    result.CopyFrom(arm)
    for marker in result.markers:
        if marker.name in content.colours:
            marker.color.CopyFrom(content.colours[marker.name])
    return result


def _parsed(content: object) -> CalibrationFile:
    whole = _object(content, "the file")
    _known(whole, _PARTS, "the file")
    cameras: dict[str, KnownCamera] = {}
    for name, entry in _object(whole.get("cameras", {}), '"cameras"').items():
        camera = _object(entry, f"camera {name}")
        _known(camera, _CAMERA_PARTS, f"camera {name}")
        cameras[name] = KnownCamera(
            _message(camera.get("calibration"), CameraCalibration, f"the calibration of camera {name}"),
            _message(camera.get("pose"), FrameTransform, f"the pose of camera {name}"),
        )
    colours = {
        name: _message(colour, Color, f"the colour of marker {name}") or Color()
        for name, colour in _object(whole.get("colours", {}), '"colours"').items()
    }
    return CalibrationFile(cameras, colours, _message(whole.get("description"), ArmDescription, "the description"))


def _object(value: object, what: str) -> dict[str, object]:
    if not isinstance(value, dict):
        raise ConfigError(f"{what} is not an object with names")
    return value


def _known(value: Mapping[str, object], names: frozenset[str], what: str) -> None:
    if unknown := sorted(set(value) - names):
        raise ConfigError(f"{what} has no {', '.join(unknown)}; it may have {', '.join(sorted(names))}")


def _message(value: object, kind: type[M], what: str) -> M | None:
    if value is None:
        return None
    try:
        return ParseDict(_object(value, what), kind())
    except ParseError as error:
        raise ConfigError(f"{what} is no {kind.DESCRIPTOR.full_name}: {error}") from error


def _camera_dict(camera: KnownCamera) -> dict[str, object]:
    known: dict[str, object] = {}
    if camera.calibration is not None:
        known["calibration"] = MessageToDict(camera.calibration)
    if camera.pose is not None:
        known["pose"] = MessageToDict(camera.pose)
    return known
