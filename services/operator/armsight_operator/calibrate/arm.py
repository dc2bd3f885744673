"""Where the arm's markers are in the world at many poses at once, and how that changes with each joint."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from armsight.errors import ConfigError
from armsight.v1.description_pb2 import ArmDescription
from armsight_operator.calibrate.lens import Array
from armsight_operator.calibrate.rigid import turns
from armsight_operator.report.chain import Arm, arm_of


@dataclass(frozen=True, slots=True)
class MarkedArm:
    """A described arm by what cameras see of it."""

    arm: Arm
    markers: tuple[str, ...]

    @property
    def joints(self) -> int:
        """Their number."""
        return len(self.arm.names)

    @property
    def first_axis(self) -> tuple[Array, Array]:
        """A point on joint 1's axis, and its direction, in the world."""
        rotation, _ = self.arm.base_from_world
        return self.arm.to_world(self.arm.origins[0]), self.arm.axes[0] @ rotation

    def centres(self, q: Array) -> tuple[Array, Array]:
        """Markers in the world, and how they move with the joints.

        Args:
            q: k x n joint angles in radians.

        Returns:
            k x m x 3 metres, and k x m x 3 x n metres per radian: for each joint before the marker
            ``axis x (centre - origin)``.
        """
        count, joints = q.shape
        turned, moved = np.broadcast_to(np.eye(3), (count, 3, 3)), np.zeros((count, 3))
        rotations, places, axes = [], [], []
        for index in range(joints):
            moved = moved + np.einsum("kij,j->ki", turned, self.arm.origins[index])
            axes.append(np.einsum("kij,j->ki", turned, self.arm.axes[index]))
            turned = turned @ turns(self.arm.axes[index], q[:, index])
            rotations.append(turned)
            places.append(moved)
        points = np.zeros((count, len(self.markers), 3))
        change = np.zeros((count, len(self.markers), 3, joints))
        for row, name in enumerate(self.markers):
            joint, at = self.arm.markers[name]
            points[:, row] = at if joint < 0 else places[joint] + np.einsum("kij,j->ki", rotations[joint], at)
            for index in range(joint + 1):
                change[:, row, :, index] = np.cross(axes[index], points[:, row] - places[index])
        rotation, translation = self.arm.base_from_world
        return (points - translation) @ rotation, np.einsum("ji,kmjn->kmin", rotation, change)


def joint_vector(arm: MarkedArm, joints: Mapping[str, float]) -> Array:
    """Angles by name in the arm's order.

    Raises:
        ConfigError: one is missing.
    """
    if missing := [name for name in arm.arm.names if name not in joints]:
        raise ConfigError(f"no angle of {', '.join(missing)} was recorded: are recording and description of one arm?")
    return np.array([joints[name] for name in arm.arm.names])


def marked_arm(description: ArmDescription) -> MarkedArm:
    """The arm that a description tells."""
    arm = arm_of(description)
    return MarkedArm(arm, tuple(arm.markers))
