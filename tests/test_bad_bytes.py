"""Bytes of any kind on every key: counted, visible, and nothing crashes or moves because of them."""

import numpy as np
import pytest
from armsight.topics import TOPICS, Topic, encoding_of

from rig import Rig

SEED = 20240607
TRUNCATED = b"\x0a\xff\xff\xff\x0f"
KEYS = [topic for topic in TOPICS if topic.name not in ("health", "camera_annotations", "joints_estimated")]


def payloads(topic: Topic) -> list[bytes]:  # type: ignore[type-arg]
    random = np.random.default_rng([SEED, len(topic.key)])
    noise = [random.integers(0, 256, int(size), dtype=np.uint8).tobytes() for size in random.integers(1, 4000, 12)]
    return [b"", TRUNCATED, bytes(200_000), *noise]


@pytest.mark.parametrize("topic", KEYS, ids=lambda topic: topic.name)
def test_malformed_bytes_crash_nothing_and_move_nothing(holding: Rig, topic: Topic) -> None:  # type: ignore[type-arg]
    before = holding.instances()
    pose = holding.true_joints()
    key = topic.key.replace("{name}", "1")
    for payload in payloads(topic):
        for encoding in (encoding_of(topic.message), "", "application/protobuf;armsight.v1.Nothing"):
            holding.bus.session.put(key, payload, encoding=encoding)
    holding.pause(1.0)
    assert holding.instances() == before, "a service was restarted or died"
    assert np.abs(holding.true_joints() - pose).max() < 1e-3
    holding.wait_ready()


def test_malformed_queries_are_refused_with_a_reason(holding: Rig) -> None:
    for key in ("control/mode", "control/solve_ik", "control/forward_kinematics", "sim/reset", "safety/stop"):
        for payload in (TRUNCATED, b"\xff" * 64):
            replies = list(holding.bus.session.get(key, payload=payload, timeout=5.0))
            assert replies, f"{key} gave no answer"
            assert replies[0].err is not None, f"{key} took malformed bytes"
            assert replies[0].err.payload.to_string()
    holding.wait_ready()


def test_commands_that_do_not_fit_are_refused_and_counted_by_reason(holding: Rig) -> None:
    pose = holding.true_joints()
    holding.put_command(positions={"joint1": float("nan"), "joint2": 0.0, "joint3": 0.0, "joint4": 0.0})
    holding.put_command(positions={"joint1": 9.0, "joint2": 0.0, "joint3": 0.0, "joint4": 0.0})
    holding.put_command(positions={"elbow": 0.1})
    holding.put_command(positions=dict.fromkeys(("joint1", "joint2", "joint3", "joint4"), 0.1), age_s=5.0)
    holding.pause(1.5)
    refused = {name for name in holding.counters("sim") if name.startswith("command_refused_")}
    assert len(refused) >= 4, refused
    assert np.abs(holding.true_joints() - pose).max() < 1e-3
