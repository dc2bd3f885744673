"""The orange sphere and the orange box beside the arm: found, told apart, measured, through the whole stack."""

from collections.abc import Callable, Iterator
from datetime import datetime

import numpy as np
import pytest

from armsight.times import from_timestamp
from armsight.v1.joints_pb2 import MARKER_STATUS_LOST, JointPositions, MarkerPosition
from armsight_sim.targets import visible_box, visible_sphere
from rig import Rig

pytestmark = pytest.mark.untimed

START = "2024-05-01T12:00:00Z"
FPS = 15
INSTANTS = 450  # one period of both
SIZE = (0.8, 0.4, 0.4)
CHI2_3_95 = 7.81


def seen(name: str, messages: list[bytes]) -> Iterator[tuple[float, MarkerPosition]]:
    start_ns = int(datetime.fromisoformat(START).timestamp()) * 10**9
    for payload in messages:
        positions = JointPositions.FromString(payload)
        found = next(marker for marker in positions.markers if marker.name == name)
        if found.status != MARKER_STATUS_LOST:
            yield (from_timestamp(positions.capture_time) - start_ns) * 1e-9, found


def test_sphere_and_box_are_told_apart_and_measured(make_rig: Callable[..., Rig]) -> None:
    rig = make_rig(clock="lockstep", fps=FPS, start_time=START, target="visible", mode="hold")
    messages = rig.record_from_the_start(INSTANTS)["joints/positions"]
    # without multisampling a straight side is off by up to half a pixel as a whole, 2 cm; the arm hides a part of the
    # box for a third of the time, and all of it for a tenth
    for name, truth, least_seen, p95_m in (
        ("target_sphere", visible_sphere, 0.98, 0.01),
        ("target_box", visible_box, 0.8, 0.05),
    ):
        errors, d2 = [], []
        for t, found in seen(name, messages):
            apart = np.array([found.position.x, found.position.y, found.position.z]) - truth(t)
            errors.append(float(np.linalg.norm(apart)))
            d2.append(float(apart @ np.linalg.solve(np.array(found.covariance).reshape(3, 3), apart)))
        assert len(errors) > least_seen * INSTANTS, name
        assert np.percentile(errors, 95) < p95_m, name
        assert np.mean(np.array(d2) < CHI2_3_95) > 0.88, f"{name}: its covariance claims too much"
        assert not [e for e, surprise in zip(errors, d2, strict=True) if surprise > 50 and e > 0.02], name
    sizes = [(found.extent.x, found.extent.y, found.extent.z) for _, found in seen("target_box", messages)]
    assert np.percentile(np.abs(np.array(sizes) - SIZE).max(axis=1), 95) < 0.1
