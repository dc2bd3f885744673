"""Rotations and poses of rigid bodies, in NumPy. A pose ``T_a_b`` maps points of frame b into frame a: R p + t."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from armsight.calibration import checked_pose, optical_frame
from armsight_operator.calibrate.lens import Array
from armsight_operator.rotations import of_matrix, to_matrix


@dataclass(frozen=True, slots=True)
class CameraPose:
    """Where a camera stands and looks: T_world_camera."""

    rotation: Array
    """3 x 3: the camera's axes in the world, as columns."""
    position: Array
    """Metres, world."""

    def seen(self, world: Array) -> Array:
        """Points of the world in the camera's frame."""
        return np.asarray((world - self.position) @ self.rotation)

    def to_world(self, points: Array) -> Array:
        """Points of the camera's frame in the world."""
        return np.asarray(points @ self.rotation.T + self.position)


def cross_matrix(vector: Array) -> Array:
    """The matrix that takes the cross product with a vector; of leading dimensions a batch."""
    result = np.zeros((*vector.shape[:-1], 3, 3))
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    result[..., 0, 1], result[..., 0, 2], result[..., 1, 2] = -z, y, -x
    result[..., 1, 0], result[..., 2, 0], result[..., 2, 1] = z, -y, x
    return result


def turn(vector: Array) -> Array:
    """The rotation by a vector's length about its direction."""
    angle = np.linalg.norm(vector)
    return turns(vector / angle, angle) if angle >= 1e-12 else np.asarray(np.eye(3) + cross_matrix(vector))


def turns(axis: Array, angles: Array | np.floating[Any]) -> Array:
    """Rotations about a unit vector, (..., 3, 3), by angles (...,) in radians (Rodrigues)."""
    k = cross_matrix(axis)
    sin, cos = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
    return np.asarray(np.eye(3) + sin * k + (1 - cos) * (k @ k))


def aligned(points: Array, world: Array, weights: Array) -> CameraPose:
    """The pose that brings points of a camera's frame nearest to their places in the world (Kabsch).

    Args:
        points: n x 3, camera's frame.
        world: n x 3.
        weights: n, not all 0.
    """
    share = weights / weights.sum()
    here, there = share @ points, share @ world
    u, _, vt = np.linalg.svd((world - there).T @ ((points - here) * share[:, None]))
    rotation = u @ np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ vt)))]) @ vt
    return CameraPose(rotation, there - rotation @ here)


def pose_of(message: FrameTransform, camera: str) -> CameraPose:
    """The pose that a message tells.

    Raises:
        ConfigError: it is none, or not in the world.
    """
    message = checked_pose(message, camera)
    q, t = message.rotation, message.translation
    norm = math.hypot(q.w, q.x, q.y, q.z)
    return CameraPose(to_matrix((q.w / norm, q.x / norm, q.y / norm, q.z / norm)), np.array([t.x, t.y, t.z]))


def message_of_pose(pose: CameraPose, camera: str) -> FrameTransform:
    """A pose as it goes over the bus."""
    message = FrameTransform(parent_frame_id="world", child_frame_id=optical_frame(camera))
    message.translation.x, message.translation.y, message.translation.z = map(float, pose.position)
    w, x, y, z = of_matrix(pose.rotation.tolist())
    message.rotation.w, message.rotation.x, message.rotation.y, message.rotation.z = w, x, y, z
    return message
