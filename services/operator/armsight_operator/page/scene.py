"""The described arm as shapes to draw: positions, rotations and colours, everything in metres and unit quaternions."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from armsight.v1.description_pb2 import ArmDescription, Color, LinkShape
from armsight.v1.geometry_pb2 import Vector3
from armsight_operator import rotations
from armsight_operator.rotations import Wxyz

Array = npt.NDArray[np.float64]
Rgb = tuple[int, int, int]
Point = tuple[float, float, float]

# Squared radius of the ellipsoid with 95 % of a normal distribution in it: chi-square, three degrees of freedom.
_CHI_SQUARE_95 = 7.8147


@dataclass(frozen=True, slots=True)
class Link:
    """A cylinder along z, in its joint's frame."""

    name: str
    joint: str
    """Empty: the base frame."""
    centre: Point
    wxyz: Wxyz
    radius_m: float
    length_m: float
    color: Rgb


@dataclass(frozen=True, slots=True)
class JointFrame:
    """A joint's frame in its parent's."""

    name: str
    origin: Point
    axis: Point
    lower_rad: float
    upper_rad: float


@dataclass(frozen=True, slots=True)
class Marker:
    """A coloured thing that vision measures; radius 0: a box, whose extent is measured."""

    name: str
    radius_m: float
    color: Rgb


@dataclass(frozen=True, slots=True)
class Scene:
    """All that the description says about what is to be drawn."""

    base_position: Point
    base_wxyz: Wxyz
    joints: tuple[JointFrame, ...]
    links: tuple[Link, ...]
    markers: Mapping[str, Marker]
    """The arm's markers and the free bodies by name."""
    tip_joint: str
    tip: Point
    """In that joint's frame."""
    reach_m: float
    """From the base to the tip, stretched out."""


@dataclass(frozen=True, slots=True)
class CameraView:
    """Where a camera stands (world frame; z into the scene) and how wide it sees."""

    position: Point
    wxyz: Wxyz
    fov_y_rad: float
    aspect: float


@dataclass(frozen=True, slots=True)
class Ellipsoid:
    """Semi-axes in metres along the axes of a rotated frame."""

    wxyz: Wxyz
    semi_axes: Point


def scene_of(description: ArmDescription) -> Scene:
    """What to draw of the arm that sim describes."""
    joints = tuple(
        JointFrame(joint.name, _point(joint.origin), _point(joint.axis), joint.lower_rad, joint.upper_rad)
        for joint in description.joints
    )
    markers = {m.name: Marker(m.name, m.radius_m, srgb(m.color)) for m in description.markers}
    bodies = {b.name: Marker(b.name, b.radius_m, srgb(b.color)) for b in description.bodies}
    base = description.world_from_base
    rotation = base.rotation
    return Scene(
        base_position=_point(base.translation),
        base_wxyz=(rotation.w, rotation.x, rotation.y, rotation.z),
        joints=joints,
        links=tuple(_link(shape) for shape in description.links),
        markers=markers | bodies,
        tip_joint=description.tip.joint,
        tip=_point(description.tip.position),
        reach_m=sum(math.hypot(*joint.origin) for joint in joints) + math.hypot(*_point(description.tip.position)),
    )


def camera_view(calibration: CameraCalibration, pose: FrameTransform) -> CameraView | None:
    """A camera as drawn; nothing where its calibration can't be used."""
    if len(calibration.K) != 9 or not calibration.K[4] > 0 or not calibration.width * calibration.height:
        return None
    position, rotation = pose.translation, pose.rotation
    return CameraView(
        position=(position.x, position.y, position.z),
        wxyz=(rotation.w, rotation.x, rotation.y, rotation.z),
        fov_y_rad=2 * math.atan(calibration.height / (2 * calibration.K[4])),
        aspect=calibration.width / calibration.height,
    )


def ellipsoid(covariance: Sequence[float]) -> Ellipsoid | None:
    """The ellipsoid that holds 95 % of a position.

    Args:
        covariance: row-major 3 x 3, m²; what is none gives nothing.
    """
    if len(covariance) != 9:
        return None
    matrix = np.reshape(np.asarray(covariance, dtype=np.float64), (3, 3))
    if not np.isfinite(matrix).all():
        return None
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    if np.linalg.det(vectors) < 0:
        vectors[:, 0] = -vectors[:, 0]
    a, b, c = np.sqrt(np.maximum(values, 0.0) * _CHI_SQUARE_95)
    return Ellipsoid(rotations.of_matrix(vectors.tolist()), (float(a), float(b), float(c)))


def srgb(color: Color) -> Rgb:
    """Linear RGB from 0 to 1 as screens want it."""

    def byte(linear: float) -> int:
        bounded = min(1.0, max(0.0, linear))
        curved = 12.92 * bounded if bounded <= 0.0031308 else 1.055 * bounded ** (1 / 2.4) - 0.055
        return round(255 * curved)

    return byte(color.red), byte(color.green), byte(color.blue)


def _link(shape: LinkShape) -> Link:
    start, end = np.array(_point(shape.start)), np.array(_point(shape.end))
    along = end - start
    length = float(np.linalg.norm(along))
    x, y, z = (start + end) / 2
    return Link(
        name=shape.name,
        joint=shape.joint,
        centre=(float(x), float(y), float(z)),
        wxyz=rotations.from_z_to(along.tolist()),
        radius_m=shape.radius_m,
        length_m=length,
        color=srgb(shape.color),
    )


def _point(vector: Vector3) -> Point:
    return vector.x, vector.y, vector.z
