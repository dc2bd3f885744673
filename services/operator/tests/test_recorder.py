"""The recorder on a real bus, as a process of its own."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from armsight import topics
from armsight.bus import Bus, Publisher
from armsight.errors import NoReplyError
from armsight_operator.recording.info import Info, info_of
from armsight_operator.recording.reader import Recording
from fake_arm import description
from recorded import messages
from secure_bus import SecureBus

READY_S = 15.0


class Process:
    """`armsight record`, started and waited for."""

    def __init__(self, endpoint: str, *words: str, fsize: int | None = None) -> None:
        code = "from armsight_operator.cli.app import main; main()"
        if fsize is not None:
            code = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({fsize}, {fsize})); {code}"
        command = [sys.executable, "-c", code, "record", *words, "--connect", endpoint]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def wait_ready(self) -> None:
        """It says which file it records to once it listens and something came."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line.startswith("records to"), line

    def end(self, number: int = signal.SIGTERM) -> tuple[int, str, str]:
        self.process.send_signal(number)
        out, err = self.process.communicate(timeout=20)
        return self.process.returncode, out, err


@pytest.fixture
def recorder(endpoint: str) -> Iterator[Callable[..., Process]]:
    started: list[Process] = []

    def start(*words: str, fsize: int | None = None) -> Process:
        started.append(Process(endpoint, *words, fsize=fsize))
        started[-1].wait_ready()
        return started[-1]

    yield start
    for one in started:
        one.process.kill()
        one.process.communicate()


class Run:
    """Puts a made-up run on the bus."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._publishers: dict[str, Publisher[object]] = {}  # type: ignore[type-var]

    def put(self, instants: int, pause_s: float = 0.0) -> int:
        count = 0
        for topic, name, _, payload in messages(instants, 32):
            key = topic.key_for(name or None)
            if key not in self._publishers:
                self._publishers[key] = self._bus.publisher(topic, name or None)
                time.sleep(0.05)  # for the recorder to hear of it
            self._publishers[key].put_bytes(payload)
            count += 1
            if pause_s and topic is topics.CLOCK:
                time.sleep(pause_s)
        return count


@pytest.fixture
def run(make_bus: Callable[[], Bus]) -> Run:
    return Run(make_bus())


def counted(path: Path) -> Info:
    return info_of(Recording(path))


def test_everything_that_is_put_is_recorded(recorder: Callable[..., Process], run: Run, tmp_path: Path) -> None:
    process = recorder(str(tmp_path / "run.mcap"))
    count = run.put(50, 0.01)
    time.sleep(0.3)
    began = time.monotonic()
    code, out, err = process.end()
    assert time.monotonic() - began < 4.0
    assert (code, err) == (0, "")
    assert "lost none" in out
    info = counted(tmp_path / "run.mcap")
    assert info.complete
    assert info.lost == 0
    # its own health is on the bus, too
    assert info.messages - info.keys["health/recorder"].count == count
    assert f"recorded {info.messages} messages" in out


def test_latched_values_from_before_are_recorded(
    recorder: Callable[..., Process], make_bus: Callable[[], Bus], tmp_path: Path
) -> None:
    bus = make_bus()
    bus.publisher(topics.DESCRIPTION).put(description())
    process = recorder(str(tmp_path / "run.mcap"))
    time.sleep(1.0)
    process.end()
    assert counted(tmp_path / "run.mcap").keys["description"].count == 1


def test_only_chosen_keys_are_subscribed_to(
    recorder: Callable[..., Process], make_bus: Callable[[], Bus], tmp_path: Path
) -> None:
    bus = make_bus()
    image, clock = bus.publisher(topics.CAMERA_IMAGE, "1"), bus.publisher(topics.CLOCK)
    process = recorder(str(tmp_path / "run.mcap"), "--without", "camera/*/image")
    until = time.monotonic() + 5
    while not clock.has_subscribers():
        assert time.monotonic() < until
        time.sleep(0.01)
    assert not image.has_subscribers(), "pixels that nobody wants cost nothing"
    process.end()


def test_sigkill_leaves_all_but_the_last_second(recorder: Callable[..., Process], run: Run, tmp_path: Path) -> None:
    process = recorder(str(tmp_path / "run.mcap"))
    count = run.put(30, 0.01)
    time.sleep(2.5)
    process.end(signal.SIGKILL)
    info = counted(tmp_path / "run.mcap")
    assert not info.complete
    assert info.messages - info.keys["health/recorder"].count == count


def test_full_disk_ends_it_with_one_sentence(recorder: Callable[..., Process], run: Run, tmp_path: Path) -> None:
    process = recorder(str(tmp_path / "run.mcap"), "--compression", "none", fsize=300_000)
    run.put(80, 0.02)
    _, err = process.process.communicate(timeout=20)
    assert process.process.returncode == 1
    assert err.startswith("armsight: can't go on writing to")
    assert err.count("\n") == 1
    info = counted(tmp_path / "run.mcap")
    assert info.messages > 50


def test_it_answers_and_tells_its_health_while_it_runs(
    recorder: Callable[..., Process], run: Run, make_bus: Callable[[], Bus], tmp_path: Path
) -> None:
    from google.protobuf.empty_pb2 import Empty

    bus = make_bus()
    with pytest.raises(NoReplyError):
        bus.query(topics.ASK_PARAMETERS, Empty(), "recorder", timeout_s=0.5)
    health = bus.subscriber(topics.HEALTH, "recorder", keep=16)
    process = recorder(str(tmp_path / "run.mcap"))
    count = run.put(10, 0.01)
    assert "run.mcap" in bus.query(topics.ASK_PARAMETERS, Empty(), "recorder").json
    until = time.monotonic() + 10
    while (said := health.recv(5.0)) is not None and said.message.gauges.get("messages_written", 0) < count:
        assert time.monotonic() < until
    assert said is not None
    assert said.message.gauges["messages_lost"] == 0
    assert said.message.gauges["bytes_written"] > 0
    assert "run.mcap" in said.message.detail
    process.end()


def test_with_certificates_its_own_is_enough(tmp_path: Path) -> None:
    secure = SecureBus(tmp_path / "certs")
    secure.start_router()
    words = [str(tmp_path / "run.mcap"), "--zenoh-config", str(secure.file("recorder"))]
    process = Process(secure.endpoint, *words)
    try:
        health = secure.bus("operator").subscriber(topics.HEALTH, "recorder")
        process.wait_ready()
        assert health.recv(10.0) is not None, "its health is heard"
        sim = secure.bus("sim")
        sim.publisher(topics.DESCRIPTION).put(description())
        clock = sim.publisher(topics.CLOCK)
        until = time.monotonic() + 10
        while not clock.has_subscribers():
            assert time.monotonic() < until
            time.sleep(0.01)
        clock.put(topics.CLOCK.message(frame=7))
        time.sleep(1.0)
        code, out, err = process.end()
        assert (code, err) == (0, ""), out
    finally:
        process.process.kill()
        process.process.communicate()
        secure.close()
    found = counted(tmp_path / "run.mcap")
    assert {key: found.keys[key].count for key in ("clock", "description")} == {"clock": 1, "description": 1}
