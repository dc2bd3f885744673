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
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
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
