"""Where a camera should see the markers."""

from collections.abc import Mapping

import numpy as np

from armsight.v1.description_pb2 import ArmDescription
from armsight_operator.calibrate.arm import joint_vector, marked_arm
from armsight_operator.calibrate.lens import Lens, project
from armsight_operator.calibrate.rigid import CameraPose


def places(
    description: ArmDescription, lens: Lens, pose: CameraPose, joints: Mapping[str, float]
) -> tuple[dict[str, tuple[float, float]], dict[str, float]]:
    """Column and row of each marker that is in front of the camera, and the radius of its disc in pixels.

    Raises:
        ConfigError: an angle is missing.
    """
    arm = marked_arm(description)
    world, _ = arm.centres(joint_vector(arm, joints)[None])
    seen = pose.seen(world[0])
    radius = {marker.name: marker.radius_m for marker in description.markers}
    at: dict[str, tuple[float, float]] = {}
    radii: dict[str, float] = {}
    for name, point in zip(arm.markers, seen, strict=True):
        if point[2] <= radius[name]:
            continue
        pixels, _ = project(lens, point[None])
        at[name] = float(pixels[0, 0]), float(pixels[0, 1])
        radii[name] = float(np.mean(lens.focal) * radius[name] / point[2])
    return at, radii
