"""What the file of calibrations says of the cameras that are here, checked before anything starts."""

from dataclasses import dataclass
from pathlib import Path

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from armsight.calibration import CalibrationFile, KnownCamera
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
    calibration, pose = CameraCalibration(), FrameTransform()
    calibration.CopyFrom(known.calibration)
    pose.CopyFrom(known.pose)
    if not calibration.width or not calibration.height or len(calibration.K) != 9:
        raise ConfigError(
            f"{path}: the calibration of camera {name} has no size or not the 9 numbers of K: "
            "`armsight calibrate intrinsics` makes it anew"
        )
    if pose.parent_frame_id not in ("", "world"):
        raise ConfigError(
            f"{path}: the pose of camera {name} is in the frame {pose.parent_frame_id!r} instead of 'world': "
            "`armsight calibrate extrinsics` makes it anew"
        )
    # as vision and 3D panels know them, whoever made the file
    pose.parent_frame_id = "world"
    pose.child_frame_id = calibration.frame_id = f"camera_{name}_optical"
    return Calibrated(calibration, pose)
