"""One vision process with several robots: each has its own, and none costs another anything."""

import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from filmed_robot import FilmedRobot, filmed_robot, flooding
from google.protobuf.empty_pb2 import Empty

from armsight import topics
from armsight.bus import open_bus
from armsight.session import SessionConfig, open_session
from armsight.topics import SERVICES
from armsight.v1.health_pb2 import HEALTH_STATUS_OK, HEALTH_STATUS_WAITING, Health
from armsight.v1.parameters_pb2 import ParameterValue, SetParametersRequest
from armsight_operator.certs.configuration import configurations
from armsight_operator.certs.folder import Folder
from armsight_operator.certs.layout import ROUTER
from armsight_operator.stack import Stack, free_port

A, B, C = "robots/a", "robots/b", "robots/c"
RATE_HZ = 30.0
SECONDS = 6.0


@pytest.fixture(scope="module")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """A router, and one vision for three robots."""
    out = tmp_path_factory.mktemp("robots")
    with Stack(out=out, namespace=A, extra={"vision": ["--namespace", B, "--namespace", C]}) as stack:
        stack.start("router")
        stack.start("vision")
        yield stack


@pytest.fixture
def robots(stack: Stack) -> Iterator[tuple[FilmedRobot, FilmedRobot]]:
    """Two of them, both answered."""
    with ExitStack() as closing:
        both = tuple(closing.enter_context(filmed_robot(stack.endpoint, name)) for name in (A, B))
        for robot in both:
            robot.begin()
        yield both[0], both[1]


def until(condition: Callable[[], bool], what: str, timeout_s: float = 5.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, f"not within {timeout_s:g} s: {what}"
        time.sleep(0.02)


def fresh_health(robot: FilmedRobot) -> Health:
    before = robot.health
    until(lambda: robot.health not in (None, before), "vision tells how it is")
    assert robot.health is not None
    return robot.health


def p99(values: list[float]) -> float:
    assert values, "nothing was answered"
    return sorted(values)[int(0.99 * (len(values) - 1))]


def filmed(robot: FilmedRobot) -> tuple[float, float, float]:
    """Of some seconds at 30 Hz: the share that was answered, p99 of its latency and of vision's part in that, ms."""
    robot.forget()
    robot.film_for(SECONDS, RATE_HZ)
    latencies = robot.latencies_ms()
    return len(latencies) / len(robot.asked), p99(latencies), p99(list(robot.measured_ms.values()))


def test_each_robot_is_answered_on_its_own_keys_and_has_its_own_health(
    robots: tuple[FilmedRobot, FilmedRobot],
) -> None:
    a, b = robots
    before = fresh_health(a).counters["instants_answered"], fresh_health(b).counters["instants_answered"]
    for _ in range(10):
        a.film()
        time.sleep(0.05)
    assert len(a.latencies_ms()) == 10
    assert not a.answered.keys() & b.answered.keys()
    after = fresh_health(a), fresh_health(b)
    assert after[0].counters["instants_answered"] == before[0] + 10
    assert after[1].counters["instants_answered"] == before[1]
    assert after[0].instance != after[1].instance


def test_a_parameter_is_set_for_one_robot_alone(robots: tuple[FilmedRobot, FilmedRobot]) -> None:
    def floors() -> list[float]:
        told = [robot.bus.query(topics.ASK_PARAMETERS, Empty(), name="vision", timeout_s=3) for robot in robots]
        return [next(p.value.number for p in each.parameters if p.name == "chroma_floor") for each in told]

    start = floors()
    wanted = SetParametersRequest(values={"chroma_floor": ParameterValue(number=start[0] + 1)})
    robots[0].bus.query(topics.SET_PARAMETERS, wanted, name="vision", timeout_s=3)
    assert floors() == [start[0] + 1, start[1]]


def test_robot_that_floods_takes_nothing_from_another(stack: Stack, robots: tuple[FilmedRobot, FilmedRobot]) -> None:
    # setup: a at 30 Hz, alone
    a, b = robots
    alone = filmed(a)
    # fault: b's frames come eight times as often
    counted = fresh_health(b).counters["frames_received"]
    with flooding(stack.endpoint, B, 8 * RATE_HZ):
        began = time.monotonic()
        beside = filmed(a)
        rate_hz = (fresh_health(b).counters["frames_received"] - counted) / 2 / (time.monotonic() - began)
    for when, (share, p99_ms, measured_ms) in (("alone", alone), (f"beside {rate_hz:.0f} Hz", beside)):
        print(f"{when}: {share:.1%} answered, p99 {p99_ms:.1f} ms, of it in vision {measured_ms:.1f} ms")
    # invariant: a's instants are answered in time all the same
    assert rate_hz > 4 * RATE_HZ
    assert beside[0] > 0.95
    assert beside[2] < 1000 / RATE_HZ
    assert beside[1] < 100


def test_bad_bytes_of_one_robot_and_another_that_never_comes_delay_nobody(
    stack: Stack, robots: tuple[FilmedRobot, FilmedRobot]
) -> None:
    a, b = robots
    counted = fresh_health(b).counters["malformed_camera_image"]
    images = b.bus.publisher(topics.CAMERA_IMAGE, "1")
    bad = bytes(range(256)) * 4
    with filmed_robot(stack.endpoint, C, described=False) as c:
        a.forget()
        for _ in range(100):
            a.film()
            c.film()
            for _ in range(5):
                images.put_bytes(bad)
            time.sleep(1 / RATE_HZ)
        latencies = a.latencies_ms()
        waiting = fresh_health(c)
    assert len(latencies) > 95
    assert p99(latencies) < 100
    assert fresh_health(b).counters["malformed_camera_image"] >= counted + 50
    assert waiting.status == HEALTH_STATUS_WAITING
    assert "description" in waiting.detail
    assert stack.running("vision")


def test_robot_that_falls_silent_is_told_of_in_its_own_health_alone(
    robots: tuple[FilmedRobot, FilmedRobot],
) -> None:
    a, b = robots
    a.film_for(3.5, RATE_HZ)
    assert fresh_health(a).status == HEALTH_STATUS_OK
    assert fresh_health(b).status == HEALTH_STATUS_WAITING


def test_health_asks_for_every_robot(stack: Stack) -> None:
    def probe(*names: str) -> subprocess.CompletedProcess[str]:
        robots = [flag for name in names for flag in ("--namespace", name)]
        command = [stack.command("vision")[0], "--health", "--connect", stack.endpoint, *robots]
        return subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)

    assert probe(A, B, C).returncode == 0
    missing = probe(A, "robots/nobody")
    assert missing.returncode == 1
    assert "robots/nobody" in missing.stderr


def test_stops_as_soon_with_several_robots(tmp_path: Path) -> None:
    names = [f"robots/{index}" for index in range(8)]
    flags = [flag for name in names for flag in ("--namespace", name)]
    with Stack(out=tmp_path, namespace=A, extra={"vision": flags}) as stack, ExitStack() as closing:
        stack.start("router")
        stack.start("vision")
        last = closing.enter_context(filmed_robot(stack.endpoint, A))
        last.begin()
        began = time.monotonic()
        process = stack.process("vision")
        assert process is not None
        process.send(15)
        assert process.wait(5)
        took_s = time.monotonic() - began
        assert process.poll() == 0
    assert took_s < 1.5


def test_one_certificate_of_vision_serves_all_robots_that_it_was_made_for(tmp_path: Path) -> None:
    roles = {name: name for name in (ROUTER, *SERVICES, "operator")}
    folder = Folder(tmp_path / "certs")
    folder.make(roles, ["127.0.0.1"], days=1, ca_days=1)
    port = free_port()
    endpoint = f"tls/127.0.0.1:{port}"
    for name, text in configurations(roles, [endpoint], [endpoint], [A, B]).items():
        folder.write_configuration(name, text)
    extra = {"vision": ["--namespace", B, "--namespace", C]}
    with (
        Stack(out=tmp_path / "stack", port=port, namespace=A, certificates=folder.path, extra=extra) as stack,
        ExitStack() as closing,
    ):
        stack.start("router")
        stack.start("vision")
        healths = {}
        for name in (A, B, C):
            config = SessionConfig(
                endpoints=(endpoint,), namespace=name, shared_memory="off", file=stack.zenoh_config("operator")
            )
            session = open_session(config, threading.Event())
            assert session is not None
            bus = closing.enter_context(open_bus(session))
            healths[name] = bus.subscriber(topics.HEALTH, "vision")
        until(lambda: bool(healths[A].latest and healths[B].latest), "vision tells of both robots", 20)
        # and of the one that its certificate is not for, nothing gets out in twice the time that health takes
        time.sleep(2.0)
        assert healths[C].latest is None
