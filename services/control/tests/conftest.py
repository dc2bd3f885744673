"""The report's arm as a description, and positions of its markers by forward kinematics: a camera without pixels."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import pytest
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from armsight.times import to_timestamp
from armsight.v1.description_pb2 import ArmDescription, Attachment, Joint, Marker
from armsight.v1.geometry_pb2 import Quaternion, Transform, Vector3
from armsight.v1.joints_pb2 import (
    MARKER_STATUS_LOST,
    MARKER_STATUS_TRACKED,
    JointPositions,
    MarkerPosition,
    MarkerStatus,
)
from armsight_control.chain import Array
from armsight_control.description import Arm, arm_of
from armsight_control.kinematics import position

SEED = 20_260_311
JOINTS = (
    ("joint1", (0, 0, 0), (0, 0, 1), math.pi),
    ("joint2", (0, 0, 4.0), (0, 1, 0), math.pi / 2),
    ("joint3", (0, 0, 0), (1, 0, 0), math.pi / 2),
    ("joint4", (0, 0, 3.2), (0, 1, 0), math.pi / 2),
)
MARKERS = (("green", "joint1", 0.35, 0.7), ("yellow", "joint2", 0.30, 0.6), ("blue", "joint4", 0.20, 0.4))
RED = ("red", "joint4", 2.95, 0.3)


def _vector(values: tuple[float, float, float]) -> Vector3:
    return Vector3(x=values[0], y=values[1], z=values[2])


def report_description() -> ArmDescription:
    return ArmDescription(
        name="arm",
        world_from_base=Transform(translation=_vector((0, 0, 0.5)), rotation=Quaternion(w=1)),
        joints=[
            Joint(
                name=name,
                origin=_vector(origin),
                axis=_vector(axis),
                lower_rad=-limit,
                upper_rad=limit,
                max_speed_rad_s=5,
            )
            for name, origin, axis, limit in JOINTS
        ],
        markers=[
            Marker(name=name, centre=Attachment(joint=joint, position=_vector((0, 0, z))), radius_m=radius)
            for name, joint, z, radius in (*MARKERS, RED)
        ],
        tip=Attachment(joint="joint4", position=_vector((0, 0, 2.8))),
        cameras=["1", "2"],
    )


@dataclass
class Camera:
    """Makes `joints/positions` of a configuration."""

    arm: Arm
    sigma_m: float = 0.0
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(SEED))

    def positions(self, q: Array, capture_ns: int, status: Mapping[str, MarkerStatus] | None = None) -> JointPositions:
        message = JointPositions(capture_time=to_timestamp(capture_ns))
        variance = max(self.sigma_m, 1e-3) ** 2
        for name, point in self.arm.markers.items():
            place = position(self.arm.chain, q, point) + self.rng.normal(0, self.sigma_m, 3)
            world = self.arm.R_world_base @ place + self.arm.p_world_base
            seen = (status or {}).get(name, MARKER_STATUS_TRACKED)
            marker = MarkerPosition(name=name, status=seen, position=_vector(tuple(world)))
            marker.covariance.extend((np.eye(3) * variance).ravel().tolist())
            if seen == MARKER_STATUS_LOST:
                marker.position.x += 3.0
            message.markers.append(marker)
        return message


def joint_states(arm: Arm, q: Array, capture_ns: int = 0) -> JointStates:
    states = [JointState(name=name, position=angle) for name, angle in zip(arm.chain.names, q, strict=True)]
    return JointStates(timestamp=to_timestamp(capture_ns), joints=states)


@pytest.fixture
def description() -> ArmDescription:
    return report_description()


@pytest.fixture
def arm(description: ArmDescription) -> Arm:
    return arm_of(description)


@pytest.fixture
def camera(arm: Arm) -> Camera:
    return Camera(arm)


@pytest.fixture
def states(arm: Arm) -> Callable[..., JointStates]:
    return lambda q, capture_ns=0: joint_states(arm, np.asarray(q, dtype=np.float64), capture_ns)


@pytest.fixture
def rng() -> np.random.Generator:
    print(f"seed {SEED}")
    return np.random.default_rng(SEED)
