import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.joints_pb2 import MARKER_STATUS_LOST, MARKER_STATUS_ONE_VIEW, JointPositions
from armsight_control.description import Arm, arm_of
from armsight_control.errors import PositionsError, UnsupportedArmError
from armsight_control.kinematics import directions, forward
from armsight_control.positions import (
    DistanceBounds,
    capture_of,
    directions_of,
    last_links_of,
    positions_of,
)

if TYPE_CHECKING:
    from tests.conftest import Camera

CAPTURE_NS = 1_700_000_000_123_456_789
POSE = np.array([0.4, -0.3, 0.7, -0.9])


def test_markers_give_the_directions_of_the_links_through_their_offsets(
    arm: Arm, camera: "Camera", rng: np.random.Generator
) -> None:
    links = last_links_of(arm)
    assert links.along == pytest.approx({"blue": 0.20, "red": 2.95})
    np.testing.assert_allclose(links.shoulder, [0, 0, 4.0])
    for q in rng.uniform(-1.5, 1.5, size=(100, 4)):
        found = directions_of(positions_of(camera.positions(q, CAPTURE_NS), arm), links)
        r3, r4 = directions(q)
        np.testing.assert_allclose(found.r3, r3, atol=1e-9)
        np.testing.assert_allclose(found.r4, r4, atol=1e-9)
        np.testing.assert_allclose(found.tip, forward(arm.chain, q), atol=1e-9)


def test_a_vague_marker_is_weighted_by_its_covariance(arm: Arm, camera: "Camera") -> None:
    # red seen by camera 1 alone, 0.3 m off along its ray (world x), and its covariance says so
    message = camera.positions(POSE, CAPTURE_NS, {"red": MARKER_STATUS_ONE_VIEW})
    red = next(marker for marker in message.markers if marker.name == "red")
    red.position.x += 0.3
    red.covariance[0] = 0.3**2
    found = directions_of(positions_of(message, arm), last_links_of(arm))
    off = np.linalg.norm(found.tip - forward(arm.chain, POSE))
    assert off < 0.05, f"the known lengths correct most of the 0.3 m, {off:.3f} m remain"


def test_a_lost_marker_is_never_used(arm: Arm, camera: "Camera") -> None:
    for name in ("blue", "red"):
        positions = positions_of(camera.positions(POSE, CAPTURE_NS, {name: MARKER_STATUS_LOST}), arm)
        assert name not in positions.seen
        with pytest.raises(PositionsError, match=f"{name} can't be seen"):
            directions_of(positions, last_links_of(arm))


def test_markers_the_arm_does_not_have_are_left_out(arm: Arm, camera: "Camera") -> None:
    message = camera.positions(POSE, CAPTURE_NS)
    message.markers.add(name="orange")
    assert "orange" not in positions_of(message, arm).seen


@pytest.mark.parametrize(
    ("reason", "change"),
    [
        ("position", lambda m: setattr(m.markers[3].position, "x", math.nan)),
        ("position", lambda m: setattr(m.markers[3].position, "x", 1e300)),
        ("position", lambda m: m.markers[3].ClearField("position")),
        ("covariance", lambda m: m.markers[3].covariance.pop()),
        ("covariance", lambda m: m.markers[3].covariance.__setitem__(0, math.inf)),
        ("covariance", lambda m: m.markers[3].covariance.__setitem__(0, -1.0)),
        ("covariance", lambda m: m.markers[3].covariance.__setitem__(1, 0.5)),
        ("status", lambda m: setattr(m.markers[3], "status", 0)),
        ("status", lambda m: setattr(m.markers[3], "status", 77)),
        ("twice", lambda m: setattr(m.markers[3], "name", "blue")),
        ("time", lambda m: setattr(m.capture_time, "nanos", -1)),
        ("time", lambda m: setattr(m.capture_time, "seconds", -5)),
        ("time", lambda m: setattr(m.capture_time, "seconds", 1 << 60)),
    ],
)
def test_values_that_no_measurement_has_are_refused(
    reason: str, change: Callable[[JointPositions], None], arm: Arm, camera: "Camera"
) -> None:
    message = camera.positions(POSE, CAPTURE_NS)
    change(message)
    with pytest.raises(PositionsError) as refused:
        positions_of(message, arm)
    assert refused.value.reason == reason


def test_capture_time_is_exact_to_the_nanosecond(camera: "Camera") -> None:
    assert capture_of(camera.positions(POSE, CAPTURE_NS)) == CAPTURE_NS


def test_poses_of_the_arm_are_plausible_and_wild_markers_are_not(
    arm: Arm, camera: "Camera", rng: np.random.Generator
) -> None:
    bounds = DistanceBounds(arm)
    camera.sigma_m = 0.02
    for q in rng.uniform(arm.chain.limits[:, 0], arm.chain.limits[:, 1], size=(300, 4)):
        bounds.check(positions_of(camera.positions(q, CAPTURE_NS), arm))
    for index, name in enumerate(("green", "yellow", "blue", "red")):
        message = camera.positions(POSE, CAPTURE_NS)
        message.markers[index].position.y += 1.5
        with pytest.raises(PositionsError, match=name):
            bounds.check(positions_of(message, arm))


def test_positions_too_vague_to_move_by_are_refused(arm: Arm, camera: "Camera") -> None:
    message = camera.positions(POSE, CAPTURE_NS)
    for marker in message.markers:
        del marker.covariance[:]
        marker.covariance.extend((np.eye(3) * 4.0).ravel().tolist())
    with pytest.raises(PositionsError, match="another camera must see the arm") as refused:
        directions_of(positions_of(message, arm), last_links_of(arm))
    assert refused.value.reason == "vague"


def test_an_arm_without_two_markers_on_its_last_link_is_refused(description: ArmDescription) -> None:
    del description.markers[3]
    with pytest.raises(UnsupportedArmError, match="two markers"):
        last_links_of(arm_of(description))
