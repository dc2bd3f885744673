"""A file of cameras and colours in place of the model's: what a person measured reaches everybody through sim."""

from collections.abc import Mapping
from pathlib import Path

import mujoco

from armsight.calibration import CalibrationFile, read_calibration_file
from armsight.errors import ConfigError
from armsight.v1.description_pb2 import ArmDescription
from armsight_sim import description
from armsight_sim.cameras import picture_size
from armsight_sim.settings import Settings


def read_recalibration(
    path: Path | None, sizes: Mapping[str, tuple[int, int]] | None, markers: frozenset[str]
) -> CalibrationFile:
    """What a file says of this arm's cameras and markers; nothing without a file.

    Args:
        path: the file, or none.
        sizes: columns and rows of the model's cameras by name; none where cameras are somebody else's, and what the
            file says of them is for them.
        markers: names of the model's markers.

    Raises:
        ConfigError: it can't be read, or tells of cameras, sizes or markers that the model doesn't have.
    """
    if path is None:
        return CalibrationFile()
    content = read_calibration_file(path)
    if sizes is not None:
        _check_cameras(path, content, sizes)
    if unknown := sorted(set(content.colours) - markers):
        raise ConfigError(
            f"{path}: no marker {', '.join(unknown)} in the model, which has {', '.join(sorted(markers))}"
        )
    return content


def _check_cameras(path: Path, content: CalibrationFile, sizes: Mapping[str, tuple[int, int]]) -> None:
    for name, camera in content.cameras.items():
        if name not in sizes:
            raise ConfigError(f"{path}: camera {name} is none of the model's, which are {', '.join(sizes)}")
        if camera.calibration is None:
            continue
        told, drawn = (camera.calibration.width, camera.calibration.height), sizes[name]
        if told != drawn:
            raise ConfigError(
                f"{path}: camera {name} is calibrated for pictures of {told[0]} x {told[1]}, sim draws {drawn[0]} x "
                f"{drawn[1]}: calibrate at this size, or change --width and --height"
            )


def recalibration_of(settings: Settings, model: mujoco.MjModel) -> CalibrationFile:
    """What the file of these settings says of a model's cameras and markers.

    Raises:
        ConfigError: as :func:`read_recalibration`.
    """
    sizes = None
    if not settings.external_cameras:
        names = description.camera_names(model)
        sizes = {name: picture_size(model, name, settings.width, settings.height) for name in names}
    markers = frozenset(marker.name for marker in description.describe_arm(model).markers)
    return read_recalibration(settings.calibration, sizes, markers)


def recoloured(arm: ArmDescription, content: CalibrationFile) -> ArmDescription:
    """The description with the file's colours for its markers."""
    result = ArmDescription()
    result.CopyFrom(arm)
    for marker in result.markers:
        if marker.name in content.colours:
            marker.color.CopyFrom(content.colours[marker.name])
    return result
