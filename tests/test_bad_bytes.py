"""Bytes of any kind on every key: counted, visible, and nothing crashes or moves because of them."""

import subprocess
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hostile import cases

import faults
from armsight import topics
from armsight.bus import Sample
from armsight.topics import TOPICS, Topic, encoding_of
from armsight_operator.stack import Stack, free_port
from armsight_operator.stack.executables import find_executable
from rig import JOINTS, SERVICES, Rig

SEED = 20240607
MALFORMED = b"\x0a\xff\xff\xff\x0f"
CASES, CASES_LONG, SECOND_PUBLISHER = 200, 10_000, 500
LARGE = 100_000_000
EVERY_S = 0.001
"""From put to put: who keeps the newest sample alone reads nearly all of them."""

BYTES_A_SECOND = 50e6
"""Less than frames have: what fills the bus is a test of its own."""

GOALS = ((3.0, 2.5, 7.5), (3.0, -2.5, 6.5))
"""Of the tip, far from one another."""

NAME = "1"
"""A camera's, and nobody's health or parameters."""

# What a second publisher may say without telling the checker of recordings another truth than sim's.
NOT_JUDGED_BY: tuple[Topic[Any], ...] = (
    topics.JOINT_COMMAND,
    topics.JOINT_POSITIONS,
    topics.TARGET,
    topics.CAMERA_IMAGE,
    topics.CAMERA_CALIBRATION,
    topics.CAMERA_POSE,
)


class Attack:
    """Somebody else on the bus, who has listened for a while."""

    def __init__(self, rig: Rig, seed: int) -> None:
        self._rig = rig
        self._seed = seed
        self._heard: dict[str, dict[str, list[bytes]]] = {topic.name: {} for topic in TOPICS}
        """By topic and by name in its key."""
        ends = [rig.bus.tap(topic, self._hear, "*" if "{name}" in topic.key else None) for topic in TOPICS]
        rig.wait_until(lambda: len(self._heard[topics.CAMERA_IMAGE.name].get(NAME, [])) > 3, 20, "frames were heard")
        for end in ends:
            end()

    def _hear(self, sample: Sample) -> None:
        self._heard[sample.topic.name].setdefault(sample.name, []).append(sample.payload)

    def run(self, topic: Topic[Any], count: int) -> None:
        random = np.random.default_rng([self._seed, TOPICS.index(topic)])
        genuine = [payload for said in self._heard[topic.name].values() for payload in said] or [b""]
        foreign = [
            payloads[0]
            for name, said in self._heard.items()
            for payloads in list(said.values())[:1]
            if name != topic.name
        ]
        key = topic.key.replace("{name}", NAME)
        for case in cases(topic, genuine, foreign, random, count):
            self._rig.bus.session.put(key, case.payload, encoding=case.encoding)
            time.sleep(max(EVERY_S, len(case.payload) / BYTES_A_SECOND))

    def make_good(self, topic: Topic[Any]) -> None:
        """As when sim starts again: what it says once, of itself and of its cameras, holds again."""
        if topic.delivery != "latched" or topic is topics.PARAMETERS:
            return
        for name, said in self._heard[topic.name].items():
            self._rig.bus.session.put(topic.key_for(name or None), said[-1], encoding=encoding_of(topic.message))


class Onlookers:
    """Whoever else reads what is on the bus."""

    def __init__(self, rig: Rig, folder: Path) -> None:
        commands = {
            "record": ["record", str(folder / "run.mcap")],
            "page": ["page", "--port", str(free_port())],
            "metrics": ["metrics", "--port", str(free_port())],
            "foxglove": ["bridge", "foxglove", "--port", str(free_port())],
            "topics": ["topics", "echo", "health/*"],
        }
        self._logs = {name: folder / f"{name}.log" for name in commands}
        self._processes = {}
        for name, words in commands.items():
            with self._logs[name].open("w") as log:
                command = [str(find_executable("router")), *words, "--connect", rig.stack.endpoint]
                self._processes[name] = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)

    def assert_well(self, after: str) -> None:
        for name, process in self._processes.items():
            said = self._logs[name].read_text(encoding="utf-8", errors="replace")
            assert process.poll() is None, f"{after} ended {name}: {said[-3000:]}"
            assert "Traceback" not in said, f"{after}: {name} did not expect it: {said[:3000]}"

    def close(self) -> None:
        for process in self._processes.values():
            process.terminate()
        for process in self._processes.values():
            try:
                process.wait(5)
            finally:
                process.kill()


@pytest.fixture(scope="module")
def onlookers(shared: Rig, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Onlookers]:
    """Of the stack that all of this is put to."""
    found = Onlookers(shared, tmp_path_factory.mktemp("onlookers"))
    yield found
    found.close()


@pytest.fixture(scope="module")
def attack(shared: Rig) -> Attack:
    shared.wait_ready()
    return Attack(shared, SEED)


def strike(rig: Rig, attack: Attack, onlookers: Onlookers, chosen: Sequence[Topic[Any]], count: int) -> None:
    before, pose = rig.instances(), rig.true_joints()
    for topic in chosen:
        attack.run(topic, count)
        attack.make_good(topic)
        rig.pause(0.2)
        assert all(rig.stack.running(name) for name in SERVICES), f"{topic.key} ended a service"
        onlookers.assert_well(topic.key)
    rig.wait_ready()
    assert rig.instances() == before
    assert np.abs(rig.true_joints() - pose).max() < 1e-3, "the arm moved"
    failed = {name: [key for key in rig.counters(name) if key.startswith("failed_")] for name in SERVICES}
    assert not any(failed.values()), f"what a service did not expect: {failed}"


def test_bytes_of_any_kind_crash_nothing_and_move_nothing(holding: Rig, attack: Attack, onlookers: Onlookers) -> None:
    strike(holding, attack, onlookers, TOPICS, CASES)


@pytest.mark.long
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_many_bytes_of_any_kind_crash_nothing(
    holding: Rig, attack: Attack, onlookers: Onlookers, topic: Topic[Any]
) -> None:
    strike(holding, attack, onlookers, [topic], CASES_LONG)


def test_messages_of_100_megabytes_crash_nothing_and_move_nothing(holding: Rig) -> None:
    before, pose = holding.instances(), holding.true_joints()
    for topic in TOPICS:
        holding.bus.session.put(topic.key.replace("{name}", NAME), bytes(LARGE), encoding=encoding_of(topic.message))
        holding.pause(0.3)
    holding.wait_ready()
    assert holding.instances() == before, "a service was restarted or died"
    assert np.abs(holding.true_joints() - pose).max() < 1e-3


def test_malformed_bytes_are_counted_by_everybody_who_reads_them(holding: Rig) -> None:
    for topic in (topics.JOINT_COMMAND, topics.JOINT_POSITIONS, topics.DESCRIPTION, topics.CAMERA_CALIBRATION):
        readers = [name for name in topic.readers if name in SERVICES]
        counter = f"malformed_{topic.name}"
        before = {name: holding.counters(name).get(counter, 0) for name in readers}
        for _ in range(3):
            key = topic.key.replace("{name}", NAME)
            holding.bus.session.put(key, MALFORMED, encoding=encoding_of(topic.message))
            holding.pause(0.05)
        for name in readers:
            counted = before[name] + 3
            holding.wait_until(
                lambda name=name, counter=counter, counted=counted: holding.counters(name).get(counter) == counted,  # type: ignore[misc]
                3,
                f"{name} counts {counter}",
            )


def test_second_publishers_bring_the_arm_to_nothing_that_breaks_a_promise(tracking: Rig, tmp_path: Path) -> None:
    attack = Attack(tracking, SEED + 1)
    before = tracking.instances()
    path = tmp_path / "run.mcap"
    with faults.recording(tracking, path):
        for number, topic in enumerate(NOT_JUDGED_BY):
            # setup: it is on its way
            with tracking.publishing_target(GOALS[number % 2]):
                tracking.wait_until(tracking.moving, 20, "the arm moves")
                # fault
                attack.run(topic, SECOND_PUBLISHER)
            attack.make_good(topic)
            # recovery
            ended_ns = time.time_ns()
            with tracking.publishing_target(GOALS[(number + 1) % 2]):
                tracking.wait_until(
                    lambda ended_ns=ended_ns: tracking.moved_since(ended_ns),  # type: ignore[misc]
                    2,
                    f"the arm moves after {topic.key}",
                )
        tracking.wait_ready()
    # invariants
    assert tracking.instances() == before
    faults.assert_no_violation(faults.timeline(path))


def test_malformed_queries_are_refused_with_a_reason(holding: Rig) -> None:
    for key in ("control/mode", "control/solve_ik", "control/forward_kinematics", "sim/reset", "safety/stop"):
        for payload in (MALFORMED, b"\xff" * 64):
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
