"""A file of cameras and colours in place of the model's: what a person measured reaches everybody through sim."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import mujoco

from armsight.calibration import CalibrationFile, KnownCamera, checked_lens, checked_pose, read_calibration_file
from armsight.errors import ConfigError
from armsight_sim import description
from armsight_sim.anatomy import balls
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
        ConfigError: it can't be read, has numbers that are no lens or no pose, or tells of cameras, sizes or markers
            that the model doesn't have.
    """
    if path is None:
        return CalibrationFile()
    content = read_calibration_file(path)
    if sizes is not None:
        try:
            content = replace(content, cameras=_checked(content.cameras, sizes))
        except ConfigError as error:
            raise ConfigError(f"{path}: {error}") from error
    if unknown := sorted(set(content.colours) - markers):
        raise ConfigError(
            f"{path}: no marker {', '.join(unknown)} in the model, which has {', '.join(sorted(markers))}"
        )
    return content


def _checked(cameras: Mapping[str, KnownCamera], sizes: Mapping[str, tuple[int, int]]) -> dict[str, KnownCamera]:
    result = {}
    for name, camera in cameras.items():
        if name not in sizes:
            raise ConfigError(f"camera {name} is none of the model's, which are {', '.join(sizes)}")
        lens = camera.calibration and checked_lens(camera.calibration, name)
        drawn = sizes[name]
        if lens is not None and (lens.width, lens.height) != drawn:
            raise ConfigError(
                f"camera {name} is calibrated for pictures of {lens.width} x {lens.height}, sim draws {drawn[0]} x "
                f"{drawn[1]}: calibrate at this size, or change --width and --height"
            )
        result[name] = KnownCamera(lens, camera.pose and checked_pose(camera.pose, name))
    return result


def recalibration_of(settings: Settings, model: mujoco.MjModel) -> CalibrationFile:
    """What the file of these settings says of a model's cameras and markers.

    Raises:
        ConfigError: as :func:`read_recalibration`.
    """
    sizes = None
    if not settings.external_cameras:
        names = description.camera_names(model)
        sizes = {name: picture_size(model, name, settings.width, settings.height) for name in names}
    markers = frozenset(ball.name for ball in balls(model))
    return read_recalibration(settings.calibration, sizes, markers)
