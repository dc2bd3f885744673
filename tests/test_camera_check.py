"""A camera that is not where it is said to be is noticed while the loop runs, and named in vision's health."""

import math
from collections.abc import Callable

import pytest
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from armsight import topics
from armsight.v1.health_pb2 import HEALTH_STATUS_DEGRADED, HEALTH_STATUS_OK, Health
from rig import Rig

pytestmark = pytest.mark.untimed

MOVED = "has moved, or its calibration is wrong"


def turned(pose: FrameTransform, degrees: float) -> FrameTransform:
    """The same camera, turned about its own vertical axis."""
    half = math.radians(degrees) / 2
    c, s = math.cos(half), math.sin(half)
    w, x, y, z = pose.rotation.w, pose.rotation.x, pose.rotation.y, pose.rotation.z
    result = FrameTransform()
    result.CopyFrom(pose)
    result.rotation.w, result.rotation.x = w * c - y * s, x * c - z * s
    result.rotation.y, result.rotation.z = y * c + w * s, z * c + x * s
    return result


def test_a_camera_that_is_turned_against_its_description_is_noticed(make_rig: Callable[..., Rig]) -> None:
    extra = {"sim": ["--noise", "4"], "control": ["--solver", "closed-form"]}
    rig = make_rig(clock="lockstep", target="none", mode="test-all", extra=extra)
    rig.start_all()
    rig.wait_ready()
    poses = rig.bus.subscriber(topics.CAMERA_POSE, "1")
    published = rig.bus.publisher(topics.CAMERA_POSE, "1")
    told = poses.recv(5.0)
    assert told is not None
    right = told.message

    def vision() -> Health:
        return rig.health("vision")

    def judged() -> bool:
        return {"reprojection_px_1", "reprojection_px_2"} <= set(vision().gauges)

    rig.wait_until(judged, 30, "vision tells how far its cameras are apart")
    assert vision().status == HEALTH_STATUS_OK, vision().detail
    assert max(vision().gauges["reprojection_px_1"], vision().gauges["reprojection_px_2"]) < 0.1
    # a tenth of a degree is nearly a pixel, and a few centimetres at the arm
    for degrees in (0.1, 3.0):
        published.put(turned(right, degrees))
        rig.wait_until(
            lambda: vision().status == HEALTH_STATUS_DEGRADED and MOVED in vision().detail,
            60,
            f"{degrees} degrees are noticed",
        )
    published.put(right)
    rig.wait_until(lambda: vision().status == HEALTH_STATUS_OK, 30, "and that it is right again")
