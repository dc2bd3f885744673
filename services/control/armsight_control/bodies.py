"""What vision saw, in the base frame: the tip by its markers, and the bodies beside the arm."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from armsight.v1.description_pb2 import SHAPE_BOX, SHAPE_SPHERE, ArmDescription, Shape
from armsight.v1.joints_pb2 import MARKER_STATUS_LOST, JointPositions, MarkerPosition
from armsight_control.chain import Array
from armsight_control.description import Arm
from armsight_control.positions import Positions
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


def tip_by_markers(positions: Positions, along: Mapping[str, float], length4: float) -> Seen | None:
    r"""The tip as the cameras see it, whatever the links' lengths: :math:`p_{red} - (s_{red} - L_4)\, r_4`.

    Only the distance between the tip and the marker nearest to it comes from the description (0.15 m of 6): links that
    are longer than described by 1 % change it by 1.5 mm.

    Args:
        positions: of one instant.
        along: markers on one line with the tip, name → metres along it.
        length4: of the tip, along the same line: of the report's arm the length of link 4.
    """
    names = sorted(along, key=lambda name: abs(along[name] - length4))
    nearest, farthest = names[0], names[-1]
    near, far = positions.seen.get(nearest), positions.seen.get(farthest)
    if near is None or far is None:
        return None
    between = (near.position - far.position) * math.copysign(1.0, along[nearest] - along[farthest])
    length = float(np.linalg.norm(between))
    if length < _FLOOR_M:
        return None
    offset = along[nearest] - length4
    lever = abs(offset / (along[nearest] - along[farthest]))
    sigma_m = math.hypot((1 + lever) * _worst_sigma(near.covariance), lever * _worst_sigma(far.covariance))
    return Seen(near.position - offset * between / length, sigma_m)


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
    place, covariance = [marker.position.x, marker.position.y, marker.position.z], list(marker.covariance)
    if not marker.HasField("position") or not all(abs(each) < _MAX_POSITION_M for each in place):
        return None
    if len(covariance) != 9 or not all(abs(each) < _MAX_POSITION_M**2 for each in covariance):
        return None
    matrix = np.array(covariance).reshape(3, 3)
    return Seen(arm.world_to_base(np.array(place)), _worst_sigma((matrix + matrix.T) / 2))


def _worst_sigma(covariance: Array) -> float:
    return math.sqrt(max(largest_variance(covariance), _FLOOR_M**2))
