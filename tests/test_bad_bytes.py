"""Bytes of any kind on every key: counted, visible, and nothing crashes or moves because of them."""

from collections.abc import Iterator

import numpy as np
import pytest

from armsight.topics import TOPICS, Topic, encoding_of
from armsight_operator.stack import Stack
from rig import JOINTS, Rig

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


ZERO = dict.fromkeys(JOINTS, 0.0)


@pytest.mark.parametrize(
    ("reason", "positions", "age_s"),
    [
        ("not_finite", ZERO | {"joint1": float("nan")}, 0.0),
        ("not_finite", ZERO | {"joint3": float("inf")}, 0.0),
        ("limits", ZERO | {"joint1": 9.0}, 0.0),
        ("joints", {"elbow": 0.1}, 0.0),
        ("joints", {}, 0.0),
        ("stale", ZERO | {"joint1": 0.1}, 0.5),
    ],
)
def test_command_that_does_not_fit_is_refused_and_counted(
    sim_alone: Rig, reason: str, positions: dict[str, float], age_s: float
) -> None:
    counter = f"command_refused_{reason}"
    before = sim_alone.counters("sim").get(counter, 0)
    sim_alone.put_command(positions, age_s)
    sim_alone.wait_until(lambda: sim_alone.counters("sim").get(counter, 0) == before + 1, 3, f"{counter} is counted")
    assert np.abs(sim_alone.true_joints()).max() < 1e-6


@pytest.fixture(scope="module")
def sim_alone(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """No other commands than the test's."""
    rig = Rig(Stack(out=tmp_path_factory.mktemp("sim"), target="none"))
    rig.start("router")
    rig.start("sim")
    rig.wait_until(lambda: bool(rig.bus) and rig.heard_of("sim"), 20, "sim is there")
    yield rig
    rig.close()
