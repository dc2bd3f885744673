"""The arm as sim describes it, checked once and turned into arrays."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from armsight.v1.description_pb2 import ArmDescription, Attachment
from armsight.v1.geometry_pb2 import Quaternion, Vector3
from armsight_control.chain import Array, Chain, Point
from armsight_control.errors import DescriptionError

_MAX_LENGTH_M = 1e4
_UNIT_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class Arm:
    """The chain, its markers and where its base stands."""

    name: str
    chain: Chain
    markers: Mapping[str, Point]
    """Centres of the coloured spheres."""
    R_world_base: Array
    p_world_base: Array

    def world_to_base(self, point_world: Array) -> Array:
        """Points of the world frame, (..., 3), in the base frame."""
        return np.asarray((point_world - self.p_world_base) @ self.R_world_base)


def arm_of(message: ArmDescription) -> Arm:
    """Builds the arm from its description.

    Raises:
        DescriptionError: not a serial chain of revolute joints with finite lengths, or attached to unknown joints.
    """
    names = tuple(joint.name for joint in message.joints)
    if not names or len(set(names)) != len(names) or "" in names:
        raise DescriptionError(f"the description's joints {list(names)} are not named one by one")
    limits = np.array([[joint.lower_rad, joint.upper_rad] for joint in message.joints])
    speeds = np.array([joint.max_speed_rad_s for joint in message.joints])
    if not (np.isfinite(limits).all() and (limits[:, 0] < limits[:, 1]).all()):
        raise DescriptionError("a joint's limits are not finite with lower < upper")
    if not (np.isfinite(speeds).all() and (speeds > 0).all()):
        raise DescriptionError("a joint's max_speed_rad_s is not finite and above 0")
    chain = Chain(
        names=names,
        origins=np.array([_vector(joint.origin, f"origin of {joint.name}") for joint in message.joints]),
        axes=np.array([_unit(joint.axis, f"axis of {joint.name}") for joint in message.joints]),
        limits=limits,
        max_speed=speeds,
        tip=_point(message.tip, names, "tip"),
    )
    return Arm(
        name=message.name,
        chain=chain,
        markers={marker.name: _point(marker.centre, names, f"marker {marker.name}") for marker in message.markers},
        R_world_base=_rotation(message.world_from_base.rotation),
        p_world_base=_vector(message.world_from_base.translation, "world_from_base"),
    )


def vector3(values: Array) -> Vector3:
    """A point or vector as the bus has it."""
    return Vector3(x=values[0], y=values[1], z=values[2])


def _vector(message: Vector3, what: str) -> Array:
    vector = np.array([message.x, message.y, message.z])
    if not np.isfinite(vector).all() or np.abs(vector).max() > _MAX_LENGTH_M:
        raise DescriptionError(f"{what} is {vector.tolist()}: expected finite metres")
    return vector


def _unit(message: Vector3, what: str) -> Array:
    vector = _vector(message, what)
    if abs(np.linalg.norm(vector) - 1) > _UNIT_TOLERANCE:
        raise DescriptionError(f"{what} is {vector.tolist()}: expected a unit vector")
    return vector


def _point(message: Attachment, names: tuple[str, ...], what: str) -> Point:
    if message.joint and message.joint not in names:
        raise DescriptionError(f"{what} is on {message.joint!r}; this arm has {', '.join(names)}")
    return Point(names.index(message.joint) if message.joint else -1, _vector(message.position, what))


def _rotation(message: Quaternion) -> Array:
    x, y, z, w = message.x, message.y, message.z, message.w
    if not abs(np.linalg.norm([x, y, z, w]) - 1) <= _UNIT_TOLERANCE:
        raise DescriptionError(f"world_from_base turns by ({x}, {y}, {z}, {w}): expected a unit quaternion")
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
