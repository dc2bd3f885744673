"""Pictures, videos and calibrations for tests."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from armsight.calibration import CalibrationFile, KnownCamera, write_calibration_file

WIDTH, HEIGHT = 64, 48


def picture(red: int, green: int = 0, blue: int = 0, width: int = WIDTH, height: int = HEIGHT) -> npt.NDArray[np.uint8]:
    """One colour, in OpenCV's order."""
    return np.full((height, width, 3), (blue, green, red), dtype=np.uint8)


def write_folder(folder: Path, reds: Sequence[int], **size: int) -> Path:
    folder.mkdir()
    for number, red in enumerate(reds):
        assert cv2.imwrite(str(folder / f"{number:03}.png"), picture(red, **size))
    return folder


def write_video(file: Path, reds: Sequence[int], fps: float = 25.0) -> Path:
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"MJPG"), fps, (WIDTH, HEIGHT))
    assert writer.isOpened()
    for red in reds:
        writer.write(picture(red))
    writer.release()
    return file


def known(width: int = WIDTH, height: int = HEIGHT) -> KnownCamera:
    calibration = CameraCalibration(width=width, height=height, K=[50, 0, 31.5, 0, 50, 23.5, 0, 0, 1])
    calibration.P.extend([50, 0, 31.5, 0, 0, 50, 23.5, 0, 0, 0, 1, 0])
    pose = FrameTransform(parent_frame_id="world", child_frame_id="whatever")
    pose.rotation.w = 1.0
    return KnownCamera(calibration, pose)


def write_calibration(file: Path, *names: str) -> Path:
    write_calibration_file(file, CalibrationFile({name: known() for name in names}))
    return file
