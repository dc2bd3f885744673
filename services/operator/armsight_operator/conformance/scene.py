"""The arm that the suite shows: four joints, four coloured spheres, two cameras; described, posed, measured exactly."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from armsight.times import to_timestamp, wall_ns
from armsight.v1.description_pb2 import ArmDescription, Attachment, Color, Joint, LinkShape, Marker
from armsight.v1.geometry_pb2 import Quaternion, Transform, Vector3
from armsight.v1.joints_pb2 import MARKER_STATUS_LOST, MARKER_STATUS_TRACKED, JointPositions, MarkerPosition
from armsight_operator.report.chain import Arm, arm_of

Array = npt.NDArray[np.float64]

PERIOD_NS = 33_333_333
MAX_SPEED_RAD_S = 5.0
_JOINTS = (
    ("joint1", (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), math.pi),
    ("joint2", (0.0, 0.0, 4.0), (0.0, 1.0, 0.0), math.pi / 2),
    ("joint3", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), math.pi / 2),
    ("joint4", (0.0, 0.0, 3.2), (0.0, 1.0, 0.0), math.pi / 2),
)
_MARKERS = (
    ("green", 0, 0.35, 0.7, (0.0, 1.0, 0.0)),
    ("yellow", 1, 0.30, 0.6, (1.0, 1.0, 0.0)),
    ("blue", 3, 0.20, 0.4, (0.0, 0.0, 1.0)),
    ("red", 3, 2.95, 0.3, (1.0, 0.0, 0.0)),
)
_LINKS = (("1", 0, 4.0, 0.35), ("3", 2, 3.2, 0.2), ("4", 3, 2.8, 0.1))
_SIGMA_M = 0.003
"""Of positions that are told as measured."""


def description(prefix: str = "", cameras: tuple[str, ...] = ("1", "2")) -> ArmDescription:
    """The arm; with a prefix to its joints' names it is another one."""
    names = [prefix + joint[0] for joint in _JOINTS]
    return ArmDescription(
        name=f"{prefix}arm",
        world_from_base=Transform(translation=Vector3(z=0.5), rotation=Quaternion(w=1)),
        joints=[
            Joint(
                name=prefix + name,
                origin=_vector(*origin),
                axis=_vector(*axis),
                lower_rad=-limit,
                upper_rad=limit,
                max_speed_rad_s=MAX_SPEED_RAD_S,
            )
            for name, origin, axis, limit in _JOINTS
        ],
        markers=[
            Marker(
                name=name,
                centre=Attachment(joint=names[joint], position=Vector3(z=z)),
                radius_m=radius,
                color=Color(red=color[0], green=color[1], blue=color[2]),
            )
            for name, joint, z, radius, color in _MARKERS
        ],
        tip=Attachment(joint=names[3], position=Vector3(z=2.8)),
        links=[
            LinkShape(name=name, joint=names[joint], start=Vector3(), end=Vector3(z=length), radius_m=radius)
            for name, joint, length, radius in _LINKS
        ],
        cameras=cameras,
    )


@dataclass(frozen=True, slots=True)
class Ball:
    """A sphere in the world."""

    name: str
    centre: Array
    """World frame, metres."""
    radius_m: float
    color: tuple[float, float, float]
    """Linear, 0 to 1."""


class Scene:
    """The described arm at any pose."""

    def __init__(self, described: ArmDescription) -> None:
        """Takes what :func:`description` made."""
        self.described = described
        self.arm: Arm = arm_of(described)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the joints."""
        return self.arm.names

    def balls(self, q: Array) -> list[Ball]:
        """All markers at a pose (rad)."""
        return [
            Ball(
                marker.name,
                self.arm.to_world(self.arm.point(q, self.arm.markers[marker.name])),
                marker.radius_m,
                (marker.color.red, marker.color.green, marker.color.blue),
            )
            for marker in self.described.markers
        ]

    def positions(self, q: Array, capture_ns: int, lost: tuple[str, ...] = ()) -> JointPositions:
        """What a perfect vision says of a pose; a lost marker's last position is 3 m off, as nobody may use it."""
        now = wall_ns()
        message = JointPositions(capture_time=to_timestamp(capture_ns))
        stages = message.stages
        stages.frames_sent_ns, stages.vision_received_ns, stages.vision_sent_ns = now - 2_000, now - 1_000, now
        for ball in self.balls(q):
            status = MARKER_STATUS_LOST if ball.name in lost else MARKER_STATUS_TRACKED
            marker = MarkerPosition(name=ball.name, status=status, position=_vector(*ball.centre))
            marker.covariance.extend((np.eye(3) * _SIGMA_M**2).ravel().tolist())
            if status == MARKER_STATUS_LOST:
                marker.position.x += 3.0
            message.markers.append(marker)
        return message

    def states(self, q: Array, capture_ns: int) -> JointStates:
        """Angles by name, for `joints/accepted`."""
        joints = [JointState(name=name, position=angle) for name, angle in zip(self.names, q, strict=True)]
        return JointStates(timestamp=to_timestamp(capture_ns), joints=joints)

    def jacobian(self, q: Array) -> Array:
        """Of the tip, base frame: 3 x joints, metres per radian, by central differences."""
        step = 1e-6
        columns = []
        for joint in range(len(q)):
            shift = np.zeros_like(q)
            shift[joint] = step
            columns.append((self.arm.tip_at(q + shift) - self.arm.tip_at(q - shift)) / (2 * step))
        return np.stack(columns, axis=1)


def twin(q: Array) -> Array:
    """The other pose that looks the same in every camera."""
    return np.array([q[0] - math.copysign(math.pi, q[0]), -q[1], -q[2], -q[3]])


def _vector(x: float, y: float, z: float) -> Vector3:
    return Vector3(x=x, y=y, z=z)
