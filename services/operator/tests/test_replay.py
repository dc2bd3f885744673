"""Replays on a real bus: what is put, when, and what never is."""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from armsight import topics
from armsight.bus import Bus, Sample
from armsight.errors import ConfigError
from armsight.times import to_timestamp
from armsight.topics import Topic
from armsight.v1.joints_pb2 import JointPositions
from armsight.v1.parameters_pb2 import ParametersResponse
from armsight_operator.errors import NoDataError, OperatorError
from armsight_operator.recording.reader import Recording
from armsight_operator.recording.replay import GUARDED, Played, Replay, Span, check_no_sim, inputs_of
from armsight_operator.recording.series import Limits
from recorded import PERIOD_NS, START_NS, messages, record

INPUTS = {"description", "camera/{name}/calibration", "camera/{name}/pose", "camera/{name}/image"}


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    record(tmp_path / "run.mcap", 10)
    return Recording(tmp_path / "run.mcap")


class Heard:
    """Everything that is put, with when it came."""

    def __init__(self, bus: Bus) -> None:
        self.samples: list[tuple[float, Sample]] = []
        for topic in topics.TOPICS:
            bus.tap(topic, self._take, "*" if "{name}" in topic.key else None)

    def _take(self, sample: Sample) -> None:
        self.samples.append((time.monotonic(), sample))

    def payloads(self, key: str) -> list[bytes]:
        return [sample.payload for _, sample in self.samples if sample.key == key]

    def wait_for(self, count: int) -> None:
        until = time.monotonic() + 5
        while len(self.samples) < count:
            assert time.monotonic() < until, f"{len(self.samples)} of {count}"
            time.sleep(0.01)


@pytest.fixture
def heard(make_bus: Callable[[], Bus]) -> Heard:
    return Heard(make_bus())


Play = Callable[..., Played]


@pytest.fixture
def play(make_bus: Callable[[], Bus], recording: Recording) -> Play:
    def run(
        wanted: Callable[[Topic[Any], str], bool] | None = None,
        span: Span | None = None,
        *,
        rate: float = 100.0,
        lockstep: bool = False,
        loop: bool = False,
        stop: threading.Event | None = None,
    ) -> Played:
        inputs = inputs_of("vision", guarded=False)
        chosen = wanted or (lambda topic, _: topic in inputs)
        replay = Replay(make_bus(), recording, chosen, lockstep=lockstep)
        return replay.run(stop or threading.Event(), span or Span(), rate, loop=loop)

    return run


def test_vision_gets_what_sim_said_to_it_and_nothing_else(play: Play, heard: Heard) -> None:
    played = play()
    expected = [(t.key_for(n or None), p) for t, n, _, p in messages(10) if t.key in INPUTS]
    heard.wait_for(len(expected))
    time.sleep(0.2)
    assert played.messages == len(expected)
    assert {sample.topic.key for _, sample in heard.samples} <= INPUTS
    for key in {key for key, _ in expected}:
        assert heard.payloads(key) == [payload for name, payload in expected if name == key], key


def test_frames_say_when_they_were_sent(play: Play, heard: Heard) -> None:
    before = time.time_ns()
    play()
    heard.wait_for(23)
    stamps = [int.from_bytes(s.attachment, "little") for _, s in heard.samples if s.topic is topics.CAMERA_IMAGE]
    assert len(stamps) == 20
    assert all(before < stamp <= time.time_ns() for stamp in stamps)


def test_rate_stretches_time(play: Play, heard: Heard) -> None:
    began = time.monotonic()
    play(rate=0.3)
    took = time.monotonic() - began
    assert took > 9 * PERIOD_NS / 1e9 / 0.3
    heard.wait_for(23)
    images = [at for at, sample in heard.samples if sample.key == "camera/1/image"]
    assert images[-1] - images[0] > 0.9 * 9 * PERIOD_NS / 1e9 / 0.3


def test_part_of_a_recording_has_what_was_latched_before(play: Play, heard: Heard) -> None:
    play(span=Span(4.5 * PERIOD_NS / 1e9, 7.5 * PERIOD_NS / 1e9))
    heard.wait_for(3 + 6)
    time.sleep(0.2)
    expected = [(n, p) for t, n, stamp, p in messages(10) if t is topics.CAMERA_IMAGE]
    assert heard.payloads("camera/1/image") == [p for n, p in expected if n == "1"][5:8]
    first = {sample.key for _, sample in heard.samples[:3]}
    assert first == {"description", "camera/1/calibration", "camera/2/calibration"}


def test_a_start_beyond_the_end_is_said(play: Play) -> None:
    with pytest.raises(ConfigError, match=r"is 0\.3 s long"):
        play(span=Span(5.0))


def test_loop_plays_until_it_is_asked_to_stop(play: Play, heard: Heard) -> None:
    stop = threading.Event()
    timer = threading.Timer(1.0, stop.set)
    timer.start()
    played = play(loop=True, stop=stop)
    assert played.rounds > 1
    assert len(heard.payloads("camera/1/image")) > 10


@pytest.mark.usefixtures("heard")
def test_each_round_is_announced_as_a_sim_that_has_just_come(play: Play, make_bus: Callable[[], Bus]) -> None:
    changes: list[tuple[str, bool]] = []
    make_bus().presence(lambda name, here: changes.append((name, here)))
    stop = threading.Event()
    timer = threading.Timer(2.0, stop.set)
    timer.start()
    played = play(loop=True, stop=stop)
    time.sleep(0.3)
    assert played.rounds >= 2
    assert changes == [("sim", True), ("sim", False)] * played.rounds


def test_an_unfinished_recording_is_replayed_to_its_end(play: Play, recording: Recording) -> None:
    (path,) = recording.paths
    path.write_bytes(path.read_bytes()[:-50])
    played = play()
    assert played.messages == 23
    assert recording.troubles


def test_several_files_are_one_recording(make_bus: Callable[[], Bus], tmp_path: Path) -> None:
    files = record(tmp_path / "parts.mcap", 40, Limits(seconds=0.3)).totals.files
    inputs = inputs_of("vision", guarded=False)
    replay = Replay(make_bus(), Recording(*files), lambda topic, _: topic in inputs, lockstep=False)
    played = replay.run(threading.Event(), Span(20.5 * PERIOD_NS / 1e9), 100.0, loop=False)
    assert played.messages == 3 + 2 * 19, "latched once, though every file has it"


# lockstep


def answering(bus: Bus, *, answers: int = 1000) -> list[int]:
    """Answers instants as vision does, once both frames are there; returns what it saw."""
    publisher = bus.publisher(topics.JOINT_POSITIONS)
    seen: list[int] = []

    def take(sample: Sample) -> None:
        stamp_ns = topics.CAMERA_IMAGE.message.FromString(sample.payload).timestamp.ToNanoseconds()
        seen.append(stamp_ns)
        if seen.count(stamp_ns) % 2 == 0 and len(seen) <= 2 * answers:
            time.sleep(0.02)
            publisher.put(JointPositions(capture_time=to_timestamp(stamp_ns)))

    bus.tap(topics.CAMERA_IMAGE, take, "*")
    return seen


def test_lockstep_waits_for_the_answer_to_each_instant(play: Play, make_bus: Callable[[], Bus]) -> None:
    seen = answering(make_bus())
    began = time.monotonic()
    played = play(lockstep=True)
    assert played.answered == 10
    assert seen == [START_NS + n * PERIOD_NS for n in range(10) for _ in range(2)]
    assert time.monotonic() - began > 10 * 0.02


def test_lockstep_sends_again_what_is_not_answered_and_gives_up(
    play: Play, make_bus: Callable[[], Bus], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armsight_operator.recording.replay._SEND_AGAIN_S", 0.2)
    monkeypatch.setattr("armsight_operator.recording.replay._GIVE_UP_S", 1.0)
    seen = answering(make_bus(), answers=3)
    with pytest.raises(NoDataError, match="is vision well"):
        play(lockstep=True)
    assert seen.count(seen[-1]) >= 4


def test_lockstep_without_anybody_says_so(play: Play, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("armsight_operator.recording.replay._LOCKSTEP_LISTENERS_S", 0.3)
    with pytest.raises(NoDataError, match="nobody listens"):
        play(lockstep=True)


def test_lockstep_refuses_to_replay_what_it_waits_for(play: Play) -> None:
    with pytest.raises(ConfigError, match="joints/positions is what --lockstep waits for"):
        play(lambda topic, _: topic in (topics.CAMERA_IMAGE, topics.JOINT_POSITIONS), lockstep=True)
    with pytest.raises(ConfigError, match="nothing else is answered"):
        play(lambda topic, _: topic is topics.CLOCK, lockstep=True)


# what never is


@pytest.mark.parametrize("role", ["vision", "control", "operator", "viewer", "sim"])
def test_what_moves_an_arm_is_never_an_input_unasked(role: str) -> None:
    assert not set(GUARDED) & set(inputs_of(role, guarded=False))
    assert topics.JOINT_COMMAND in GUARDED


def test_inputs_are_those_of_the_table() -> None:
    assert {topic.key for topic in inputs_of("vision", guarded=False)} == INPUTS
    control = {topic.key for topic in inputs_of("control", guarded=True)}
    assert control == {"description", "joints/positions", "joints/accepted", "target", "safety/stop", "clock"}
    with pytest.raises(ConfigError, match="there is no 'nobody'"):
        inputs_of("nobody", guarded=False)


def test_nothing_is_replayed_beside_sim(make_bus: Callable[[], Bus]) -> None:
    check_no_sim(make_bus())
    make_bus().serve(topics.ASK_PARAMETERS, lambda _: ParametersResponse(json="{}"), "sim")
    with pytest.raises(OperatorError, match="--beside-sim"):
        check_no_sim(make_bus())


def test_a_recording_without_what_is_wanted_says_what_it_has(play: Play) -> None:
    with pytest.raises(ConfigError, match="there is camera/1/calibration"):
        play(lambda topic, _: topic is topics.TARGET)
