"""Kinematics of the described arm, for the report and the page: the judge shares no code with what it judges."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from armsight.v1.description_pb2 import ArmDescription, Attachment
from armsight.v1.geometry_pb2 import Vector3
from armsight_operator.rotations import to_matrix

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

MARKER_NOISE_M = 0.002
"""Of each marker and axis, for telling which joints can be observed at a pose."""

OBSERVABLE_RAD = 0.010
"""A joint counts where that noise moves it by less."""


@dataclass(frozen=True, slots=True)
class Arm:
    """A serial chain of revolute joints with points on it; metres, radians."""

    names: tuple[str, ...]
    origins: Array
    """n x 3: of each joint in its parent's frame; the base frame is the first joint's."""
    axes: Array
    """n x 3: unit vectors in the joint's own frame."""
    limits: Array
    """n x 2: lower, upper."""
    markers: dict[str, tuple[int, Array]]
    """By name: joint that carries it, and the centre in its frame."""
    tip: tuple[int, Array]
    base_from_world: tuple[Array, Array]
    """Rotation and translation: base = R world + t."""

    def to_base(self, world: Array) -> Array:
        """Points of the world frame in the base frame."""
        rotation, translation = self.base_from_world
        return np.asarray(world @ rotation.T + translation)

    def to_world(self, base: Array) -> Array:
        """Points of the base frame in the world frame."""
        rotation, translation = self.base_from_world
        return np.asarray((base - translation) @ rotation)

    def point(self, q: Array, attached: tuple[int, Array]) -> Array:
        """Where an attached point is, in the base frame."""
        joint, position = attached
        point = position
        for index in range(joint, -1, -1):
            point = self.origins[index] + _turned(self.axes[index], float(q[index]), point)
        return point

    def tip_at(self, q: Array) -> Array:
        """The end effector, in the base frame."""
        return self.point(q, self.tip)

    def sigma(self, q: Array, free: tuple[int, ...]) -> Array:
        """Standard deviation of each free joint that 2 mm of noise on every marker cause at a pose.

        Infinite where no marker tells anything of a joint. ``sigma = sqrt(diag((J'J)^-1)) * 2 mm`` with the Jacobian
        of all marker positions with respect to the free joints, by central differences.
        """
        rows = [self._jacobian(q, attached, free) for attached in self.markers.values()]
        _, values, vectors = np.linalg.svd(np.vstack(rows), full_matrices=False)
        with np.errstate(divide="ignore", invalid="ignore"):
            scaled = np.where(np.abs(vectors) < 1e-9, 0.0, vectors / values[:, None])
        return np.asarray(MARKER_NOISE_M * np.sqrt((scaled**2).sum(axis=0)))

    def _jacobian(self, q: Array, attached: tuple[int, Array], free: tuple[int, ...]) -> Array:
        step = 1e-6
        columns = []
        for joint in free:
            shift = np.zeros_like(q)
            shift[joint] = step
            columns.append((self.point(q + shift, attached) - self.point(q - shift, attached)) / (2 * step))
        return np.stack(columns, axis=1)


def arm_of(description: ArmDescription) -> Arm:
    """The arm that sim describes."""
    names = tuple(joint.name for joint in description.joints)

    def attached(attachment: Attachment) -> tuple[int, Array]:
        joint = names.index(attachment.joint) if attachment.joint else -1
        return joint, _array(attachment.position)

    turned = description.world_from_base.rotation
    rotation = to_matrix((turned.w, turned.x, turned.y, turned.z))
    return Arm(
        names=names,
        origins=np.array([_array(joint.origin) for joint in description.joints]),
        axes=np.array([_array(joint.axis) for joint in description.joints]),
        limits=np.array([(joint.lower_rad, joint.upper_rad) for joint in description.joints]),
        markers={marker.name: attached(marker.centre) for marker in description.markers},
        tip=attached(description.tip),
        base_from_world=(rotation.T, -rotation.T @ _array(description.world_from_base.translation)),
    )


def tip_from_markers(arm: Arm, markers: dict[str, Array]) -> Array:
    """The end effector from measured marker centres, any frame: on the line through the two of the last link.

    For this arm: ``r4 = (red - blue) / 2.75``, ``tip = red - 0.15 r4``.
    """
    joint, tip = arm.tip
    on_last = [(name, centre) for name, (carrier, centre) in arm.markers.items() if carrier == joint]
    (near, near_at), (far, far_at) = sorted(on_last, key=lambda item: float(np.linalg.norm(item[1])))[-2:]
    apart = far_at - near_at
    share = float((tip - far_at) @ apart / (apart @ apart))
    return np.asarray(markers[far] + share * (markers[far] - markers[near]))


def _turned(axis: Array, angle: float, point: Array) -> Array:
    """Rodrigues' rotation."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.asarray(cos * point + sin * np.cross(axis, point) + (1 - cos) * (axis @ point) * axis)


def _array(vector: Vector3) -> Array:
    return np.array([vector.x, vector.y, vector.z])
