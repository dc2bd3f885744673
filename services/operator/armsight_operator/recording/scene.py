"""What 3D panels need and nobody says on the bus: where the arm's links are, and spheres where vision sees markers.

Converted from `description`, `joints/estimated` and `joints/positions` alone, on channels of their own that begin with
``converted/``. Frames: ``world``, ``base``, and one for each joint, by its name, as the description has them.
"""

import math
from dataclasses import dataclass
from typing import Any

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

from armsight.topics import DESCRIPTION, JOINT_POSITIONS, JOINTS_ESTIMATED, Topic
from armsight.v1 import description_pb2, geometry_pb2
from armsight.v1.description_pb2 import ArmDescription, LinkShape
from armsight.v1.joints_pb2 import MARKER_STATUS_LOST, JointPositions
from armsight_operator import rotations

PREFIX = "converted/"
TRANSFORMS, ARM, MARKERS = f"{PREFIX}transforms", f"{PREFIX}arm", f"{PREFIX}markers"

MESSAGES: dict[str, type[Message]] = {TRANSFORMS: FrameTransforms, ARM: SceneUpdate, MARKERS: SceneUpdate}
"""By channel."""

SOURCES = {TRANSFORMS: JOINTS_ESTIMATED.key, ARM: DESCRIPTION.key, MARKERS: JOINT_POSITIONS.key}
"""What each channel is converted from."""

_BODY_RADIUS_M = 0.3
"""To draw a body whose description has none: a box."""


@dataclass(frozen=True, slots=True)
class Converted:
    """One message of a converted channel."""

    channel: str
    message: Message


class Scene:
    """Converts; knows of the arm what its last description said."""

    def __init__(self) -> None:
        """Without a description nothing can be converted."""
        self._description: ArmDescription | None = None

    def convert(self, topic: Topic[Any], message: Message) -> Converted | None:
        """What one message of the bus gives for 3D panels; none for most, and none where it has numbers without end."""
        try:
            return self._converted(topic, message)
        except (ValueError, OverflowError):
            return None

    def _converted(self, topic: Topic[Any], message: Message) -> Converted | None:
        if isinstance(message, ArmDescription):
            self._description = message
            return Converted(ARM, _arm(message))
        if self._description is None:
            return None
        if isinstance(message, JointPositions):
            return Converted(MARKERS, _markers(self._description, message))
        if topic is JOINTS_ESTIMATED and isinstance(message, JointStates):
            return Converted(TRANSFORMS, _transforms(self._description, message))
        return None


def _arm(description: ArmDescription) -> SceneUpdate:
    """Links as cylinders, each in its joint's frame: they move with the transforms."""
    by_frame: dict[str, list[LinkShape]] = {}
    for link in description.links:
        by_frame.setdefault(link.joint or "base", []).append(link)
    return SceneUpdate(
        entities=[
            SceneEntity(id=f"links of {frame}", frame_id=frame, frame_locked=True, cylinders=map(_cylinder, links))
            for frame, links in by_frame.items()
        ]
    )


def _cylinder(link: LinkShape) -> CylinderPrimitive:
    start, end = _tuple(link.start), _tuple(link.end)
    along = tuple(b - a for a, b in zip(start, end, strict=True))
    cylinder = CylinderPrimitive(
        size=Vector3(x=2 * link.radius_m, y=2 * link.radius_m, z=math.hypot(*along)),
        bottom_scale=1.0,
        top_scale=1.0,
        color=_color(link.color),
    )
    position, middle = cylinder.pose.position, [(a + b) / 2 for a, b in zip(start, end, strict=True)]
    position.x, position.y, position.z = middle
    cylinder.pose.orientation.CopyFrom(_as_message(rotations.from_z_to(along)))
    return cylinder


def _markers(description: ArmDescription, positions: JointPositions) -> SceneUpdate:
    """A sphere where each marker or body is, as vision measured; translucent where it is lost."""
    known = {marker.name: (marker.radius_m, marker.color) for marker in description.markers}
    known |= {body.name: (body.radius_m or _BODY_RADIUS_M, body.color) for body in description.bodies}
    spheres = []
    for marker in positions.markers:
        if not marker.HasField("position") or marker.name not in known:
            continue
        radius, color = known[marker.name]
        sphere = SpherePrimitive(
            size=Vector3(x=2 * radius, y=2 * radius, z=2 * radius),
            color=_color(color, alpha=0.3 if marker.status == MARKER_STATUS_LOST else 1.0),
        )
        place = sphere.pose.position
        place.x, place.y, place.z = _tuple(marker.position)
        sphere.pose.orientation.w = 1.0
        spheres.append(sphere)
    entity = SceneEntity(id="markers", frame_id="world", timestamp=positions.capture_time, spheres=spheres)
    return SceneUpdate(entities=[entity])


def _transforms(description: ArmDescription, states: JointStates) -> FrameTransforms:
    """World to base, and each joint in its parent's frame at its angle."""
    base = description.world_from_base
    transforms = [
        _transform(states.timestamp, "world", "base", _tuple(base.translation), _quaternion(base.rotation)),
    ]
    angles, parent = {state.name: state.position for state in states.joints}, "base"
    for joint in description.joints:
        turned = _as_message(rotations.about(_tuple(joint.axis), angles.get(joint.name, 0.0)))
        transforms.append(_transform(states.timestamp, parent, joint.name, _tuple(joint.origin), turned))
        parent = joint.name
    return FrameTransforms(transforms=transforms)


def _transform(
    stamp: Timestamp, parent: str, child: str, translation: tuple[float, ...], rotation: Quaternion
) -> FrameTransform:
    x, y, z = translation
    return FrameTransform(
        timestamp=stamp,
        parent_frame_id=parent,
        child_frame_id=child,
        translation=Vector3(x=x, y=y, z=z),
        rotation=rotation,
    )


def _tuple(vector: geometry_pb2.Vector3) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _quaternion(q: geometry_pb2.Quaternion) -> Quaternion:
    return Quaternion(x=q.x, y=q.y, z=q.z, w=q.w)


def _as_message(wxyz: rotations.Wxyz) -> Quaternion:
    w, x, y, z = wxyz
    return Quaternion(x=x, y=y, z=z, w=w)


def _color(color: description_pb2.Color, alpha: float = 1.0) -> Color:
    return Color(r=color.red, g=color.green, b=color.blue, a=alpha)
