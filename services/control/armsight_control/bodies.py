"""What vision saw, in the base frame: the tip by its markers, and the bodies beside the arm."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from armsight.v1.description_pb2 import SHAPE_BOX, SHAPE_SPHERE, ArmDescription, Shape
from armsight.v1.joints_pb2 import MARKER_STATUS_LOST, JointPositions, MarkerPosition
from armsight_control.chain import Array
from armsight_control.description import Arm

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


def tip_by_markers(message: JointPositions, along: Mapping[str, float], length4: float, arm: Arm) -> Seen | None:
    r"""The tip as the cameras see it, whatever the links' lengths: :math:`p_{red} - (s_{red} - L_4)\, r_4`.

    Only the distance between the tip and the marker nearest to it comes from the description (0.15 m of 6): links that
    are longer than described by 1 % change it by 1.5 mm.

    Args:
        message: from vision.
        along: markers on the last link's axis, name → metres from joint 4.
        length4: of that link.
        arm: for the frames.
    """
    names = sorted(along, key=lambda name: abs(along[name] - length4))
    nearest, farthest = names[0], names[-1]
    near, far = seen(message, nearest, arm), seen(message, farthest, arm)
    if near is None or far is None:
        return None
    between = (near.position - far.position) * math.copysign(1.0, along[nearest] - along[farthest])
    length = float(np.linalg.norm(between))
    if length < _FLOOR_M:
        return None
    offset = along[nearest] - length4
    lever = abs(offset / (along[nearest] - along[farthest]))
    sigma_m = math.hypot((1 + lever) * near.sigma_m, lever * far.sigma_m)
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
    place = np.array([marker.position.x, marker.position.y, marker.position.z])
    covariance = np.array(marker.covariance)
    if not marker.HasField("position") or not (np.abs(place) < _MAX_POSITION_M).all():
        return None
    if covariance.shape != (9,) or not (np.abs(covariance) < _MAX_POSITION_M**2).all():
        return None
    matrix = covariance.reshape(3, 3)
    largest = float(np.linalg.eigvalsh((matrix + matrix.T) / 2)[-1])
    return Seen(arm.world_to_base(place), math.sqrt(max(largest, _FLOOR_M**2)))
