import math

import numpy as np
import pytest

from armsight.v1.description_pb2 import SHAPE_BOX, SHAPE_SPHERE
from armsight_sim import description
from armsight_sim.world import World


def test_description_tells_the_reports_arm(world: World) -> None:
    arm = description.describe_arm(world.model)
    assert [joint.name for joint in arm.joints] == ["joint1", "joint2", "joint3", "joint4"]
    assert [(j.axis.x, j.axis.y, j.axis.z) for j in arm.joints] == [(0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 1, 0)]
    assert [j.origin.z for j in arm.joints] == [0, 4.0, 0, pytest.approx(3.2)]
    assert arm.world_from_base.translation.z == 0.5
    assert {m.name: m.radius_m for m in arm.markers} == {"green": 0.7, "yellow": 0.6, "blue": 0.4, "red": 0.3}
    assert {m.name: m.centre.joint for m in arm.markers} == {
        "green": "joint1",
        "yellow": "joint2",
        "blue": "joint4",
        "red": "joint4",
    }
    assert {m.name: round(m.centre.position.z, 6) for m in arm.markers} == {
        "green": 0.35,
        "yellow": 0.3,
        "blue": 0.2,
        "red": 2.95,
    }
    assert arm.tip.joint == "joint4"
    assert arm.tip.position.z == pytest.approx(2.8)
    assert list(arm.cameras) == ["1", "2"]
    assert [j.upper_rad for j in arm.joints] == pytest.approx([math.pi, *[math.pi / 2] * 3])
    assert [j.lower_rad for j in arm.joints] == pytest.approx([-math.pi, *[-math.pi / 2] * 3])
    # black: what occludes a marker must not be taken for one
    assert {(link.color.red, link.color.green, link.color.blue) for link in arm.links if link.joint} == {(0, 0, 0)}


def test_bodies_beside_the_arm_are_described_when_they_are_drawn(world: World) -> None:
    assert not description.describe_arm(world.model).bodies
    sphere, box = description.describe_arm(world.model, with_bodies=True).bodies
    assert (sphere.name, sphere.shape, sphere.radius_m) == ("target_sphere", SHAPE_SPHERE, 0.4)
    assert (box.name, box.shape, box.radius_m) == ("target_box", SHAPE_BOX, 0.0)
    assert sphere.color == box.color


def test_calibration_is_opencvs_convention(world: World) -> None:
    message = description.calibration(world.model, "1", 800, 800, 0)
    assert message.K[0] == pytest.approx(476.70, abs=0.01)
    assert message.K[2] == message.K[5] == 399.5


@pytest.mark.parametrize(
    ("camera", "position", "forward", "right"),
    [("1", (18, 0, 6), (-1, 0, 0), (0, 1, 0)), ("2", (0, -18, 6), (0, 1, 0), (1, 0, 0))],
)
def test_cameras_stand_and_look_as_in_the_report(
    world: World,
    camera: str,
    position: tuple[float, float, float],
    forward: tuple[float, float, float],
    right: tuple[float, float, float],
) -> None:
    pose = description.camera_pose(world.model, camera, 0)
    assert pose.parent_frame_id == "world"
    assert pose.child_frame_id == f"camera_{camera}_optical"
    np.testing.assert_allclose((pose.translation.x, pose.translation.y, pose.translation.z), position, atol=1e-12)
    w, x, y, z = pose.rotation.w, pose.rotation.x, pose.rotation.y, pose.rotation.z
    right_axis = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
    forward_axis = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
    np.testing.assert_allclose(right_axis, right, atol=1e-9)
    np.testing.assert_allclose(forward_axis, forward, atol=1e-9)
