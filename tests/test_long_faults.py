"""Faults at random moments and floods of random bytes, many times over: `make test-long`."""

import numpy as np
import pytest

from armsight.topics import TOPICS, encoding_of
from rig import Rig

SEED = 271828
KILLS = 12
CASES = 500

pytestmark = [pytest.mark.long, pytest.mark.timeout(3000)]


def test_services_killed_at_random_moments_always_come_back(tracking: Rig) -> None:
    random = np.random.default_rng(SEED)
    with tracking.recording_truth() as truth:
        for _ in range(KILLS):
            victim = str(random.choice(["vision", "control", "router"]))
            tracking.wait_until(tracking.moving, 20, "the arm moves")
            tracking.pause(float(random.uniform(0.1, 3.0)))
            tracking.kill(victim)
            tracking.pause(float(random.uniform(0.0, 1.0)))
            tracking.start(victim)
            tracking.wait_ready()
        tracking.wait_until(tracking.moving, 20, "the arm moves in the end")
    truth.assert_speed_below(5.0)
    assert np.ptp(truth.joint(0)) < 1.5, f"joint 1 swung; seed {SEED}"


def test_flood_of_random_bytes_on_every_key_moves_nothing(holding: Rig) -> None:
    random = np.random.default_rng(SEED)
    pose, before = holding.true_joints(), holding.instances()
    for topic in TOPICS:
        if topic.name in ("health", "camera_annotations", "joints_estimated"):
            continue
        key, encoding = topic.key.replace("{name}", "1"), encoding_of(topic.message)
        for size in random.integers(0, 5000, CASES):
            payload = random.integers(0, 256, int(size), dtype=np.uint8).tobytes()
            holding.bus.session.put(key, payload, encoding=encoding)
        holding.pause(0.2)
    holding.wait_ready()
    assert holding.instances() == before
    assert np.abs(holding.true_joints() - pose).max() < 1e-3
