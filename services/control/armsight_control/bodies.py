"""What vision saw, in the base frame: the tip by its markers, and the bodies beside the arm."""

import math
from dataclasses import dataclass

import numpy as np

from armsight.v1.description_pb2 import SHAPE_BOX, SHAPE_SPHERE, ArmDescription, Shape
from armsight.v1.joints_pb2 import MARKER_STATUS_LOST, JointPositions, MarkerPosition
from armsight_control.chain import Array, Rows
from armsight_control.description import Arm
from armsight_control.positions import Positions, TipLine
from armsight_control.spread import largest_variance

_MAX_POSITION_M = 1e4
# A covariance of zero claims too much.
_FLOOR_M = 1e-3


@dataclass(frozen=True, slots=True)
class Seen:
    """One sphere or box at this instant."""

    position: Array
    """Centre, base frame, metres."""
    sigma_m: float
    """Standard deviation in the worst direction."""


def seen(message: JointPositions, name: str, arm: Arm) -> Seen | None:
    """A marker or body by name; nothing where no camera sees it, or its numbers are no measurement."""
    for marker in message.markers:
        if marker.name == name:
            return None if marker.status == MARKER_STATUS_LOST else _measured(marker, arm)
    return None


def tip_by_markers(positions: Positions, line: TipLine) -> Seen | None:
    r"""The tip as the cameras see it, whatever the links' lengths: :math:`p_{red} - (s_{red} - L_4)\, r_4`.

    Only the distance between the tip and the marker nearest to it comes from the description (0.15 m of 6): links that
    are longer than described by 1 % change it by 1.5 mm.

    Args:
        positions: of one instant.
        line: markers on one line with the tip.
    """
    nearest, farthest = line.ends
    near, far = positions.seen.get(nearest), positions.seen.get(farthest)
    if near is None or far is None:
        return None
    apart = line.along[nearest] - line.along[farthest]
    between = (near.position - far.position) * math.copysign(1.0, apart)
    length = math.hypot(*between.tolist())
    if length < _FLOOR_M:
        return None
    offset = line.along[nearest] - line.tip
    lever = abs(offset / apart)
    near_m, far_m = _worst_sigma(near.covariance.tolist()), _worst_sigma(far.covariance.tolist())
    return Seen(near.position - offset * between / length, math.hypot((1 + lever) * near_m, lever * far_m))


@dataclass(frozen=True, slots=True)
class BodyNames:
    """Which bodies the description has beside the arm: the sphere to follow, the box to avoid."""

    sphere: str | None
    box: str | None


def body_names(message: ArmDescription) -> BodyNames:
    """The first sphere and the first box of a description."""

    def first(shape: Shape) -> str | None:
        return next((body.name for body in message.bodies if body.shape == shape), None)

    return BodyNames(first(SHAPE_SPHERE), first(SHAPE_BOX))


def _measured(marker: MarkerPosition, arm: Arm) -> Seen | None:
    place, covariance = [marker.position.x, marker.position.y, marker.position.z], marker.covariance[:]
    if not marker.HasField("position") or not all(abs(each) < _MAX_POSITION_M for each in place):
        return None
    if len(covariance) != 9 or not all(abs(each) < _MAX_POSITION_M**2 for each in covariance):
        return None
    xx, xy, xz, yx, yy, yz, zx, zy, zz = covariance
    xy, xz, yz = (xy + yx) / 2, (xz + zx) / 2, (yz + zy) / 2
    return Seen(arm.world_to_base(np.array(place)), _worst_sigma(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))))


def _worst_sigma(covariance: Rows) -> float:
    return math.sqrt(max(largest_variance(covariance), _FLOOR_M**2))
