"""What the file of calibrations says of the cameras that are here, checked before anything starts."""

from dataclasses import dataclass
from pathlib import Path

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from armsight.calibration import CalibrationFile, KnownCamera, checked_lens, checked_pose
from armsight.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Calibrated:
    """One camera of which all is known."""

    calibration: CameraCalibration
    pose: FrameTransform
    """T_world_camera."""

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows of its pictures."""
        return self.calibration.width, self.calibration.height

    @property
    def frame_id(self) -> str:
        """Of its optical frame."""
        return self.pose.child_frame_id


def calibrated(content: CalibrationFile, name: str, path: Path) -> Calibrated:
    """What is known of one camera, complete, by the names of the bus whatever the file calls its frames.

    Args:
        content: of the file.
        name: the camera's.
        path: the file, for errors.

    Raises:
        ConfigError: it is not there, or a part of it is missing or can't be used; and which command makes it.
    """
    known = content.cameras.get(name, KnownCamera())
    there = ", ".join(content.cameras) or "none"
    if known.calibration is None:
        raise ConfigError(
            f"{path} has no calibration of camera {name} (it has cameras {there}): `armsight calibrate intrinsics` "
            "makes it, or name the device after one of these, --device NAME=SOURCE"
        )
    if known.pose is None:
        raise ConfigError(f"{path} has no pose of camera {name}: `armsight calibrate extrinsics` makes it")
    try:
        return Calibrated(checked_lens(known.calibration, name), checked_pose(known.pose, name))
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
