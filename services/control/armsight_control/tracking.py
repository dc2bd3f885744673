"""From the target on the bus to the configuration that `track` moves to; the solver works beside the loop."""

from dataclasses import dataclass

import numpy as np
from foxglove_schemas_protobuf.Point3InFrame_pb2 import Point3InFrame

from armsight_control.chain import Array
from armsight_control.description import Arm
from armsight_control.errors import SolverError

_MAX_TARGET_M = 1e4


@dataclass(frozen=True, slots=True)
class Target:
    """Where the tip is to be, base frame, metres."""

    stamp_ns: int
    position: Array


def target_of(message: Point3InFrame, arm: Arm) -> Target:
    """Checks a target and takes it into the base frame.

    Raises:
        SolverError: another frame than `world` or `base`, or not finite.
    """
    point = finite_target(message.point.x, message.point.y, message.point.z)
    if message.frame_id == "world":
        point = arm.world_to_base(point)
    elif message.frame_id != "base":
        raise SolverError(f"target in frame {message.frame_id!r}: expected world or base")
    return Target(message.timestamp.seconds * 1_000_000_000 + message.timestamp.nanos, point)


def finite_target(x: float, y: float, z: float) -> Array:
    """A point as an array.

    Raises:
        SolverError: not finite, or farther away than any scene is large.
    """
    point = np.array([x, y, z])
    if not (np.abs(point) < _MAX_TARGET_M).all():
        raise SolverError(f"target ({x:g}, {y:g}, {z:g}) is not finite and within {_MAX_TARGET_M:g} m")
    return point
