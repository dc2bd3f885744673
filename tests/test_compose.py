"""`docker compose up`: the images build, every container gets well, and the arm follows its target."""

import json
import os
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from armsight import topics
from armsight.bus import Bus
from armsight.session import SessionConfig, open_session
from armsight_operator.stack import free_port
from rig import Truth

ROOT = Path(__file__).parents[1]
PROJECT = "armsight-test"
EXECUTABLE = Path(sys.executable).with_name("armsight")
ROBOT, SECOND = "robots/arm", "robots/arm-2"
IMAGES = ("operator", "sim", "vision", "control", "camera")
BUILD_S, UP_S = 2400, 120

pytestmark = [pytest.mark.docker, pytest.mark.timeout(BUILD_S + 300)]


# How fast the machine draws is no matter here, and other tests run beside.
FEW_FRAMES = "--target default --fps 15 --samples 0"


class Compose:
    """The project's compose files, as a user calls them, under a name of their own."""

    def __init__(self, project: str = PROJECT, **environment: str) -> None:
        self.project = project
        self.environment = (
            os.environ
            | {"ARMSIGHT_PORT": str(free_port()), "ARMSIGHT_PAGE_PORT": str(free_port()), "ARMSIGHT_SIM": FEW_FRAMES}
            | environment
        )

    def run(self, *words: str, timeout_s: float = UP_S) -> subprocess.CompletedProcess[str]:
        command = ["docker", "compose", "--project-name", self.project, *words]
        return subprocess.run(
            command, cwd=ROOT, env=self.environment, capture_output=True, text=True, timeout=timeout_s, check=False
        )

    def __call__(self, *words: str, timeout_s: float = UP_S) -> str:
        ended = self.run(*words, timeout_s=timeout_s)
        assert ended.returncode == 0, f"docker compose {' '.join(words)}: {ended.stderr[-4000:]}"
        return ended.stdout

    def status(self, namespace: str = ROBOT) -> dict[str, Any]:
        ended = self.run(
            "exec", "-T", "operator", "armsight", "status", "--json", "--namespace", namespace, timeout_s=30
        )
        return dict(json.loads(ended.stdout)) if ended.stdout else {"said": ended.stderr}

    def container(self, service: str) -> str:
        return self("ps", "--quiet", service).strip()

    def wait_until_it_follows(self, timeout_s: float, namespace: str = ROBOT) -> dict[str, Any]:
        deadline = time.monotonic() + timeout_s
        while not follows(status := self.status(namespace)):
            assert time.monotonic() < deadline, f"not within {timeout_s:g} s: {status}\n{self('logs', '--tail', '20')}"
        return status


class Watch:
    """What the arm does in truth, from outside of the containers."""

    def __init__(self, port: str) -> None:
        self.truth = Truth()
        config = SessionConfig(endpoints=(f"tcp/127.0.0.1:{port}",), shared_memory="off")
        session = open_session(config, threading.Event())
        assert session is not None
        self._bus = Bus(session)

    def __enter__(self) -> "Watch":
        self._bus.subscriber(topics.JOINTS_TRUE, keep=1000, on_message=self.truth.add)
        return self

    def __exit__(self, *_: object) -> None:
        self._bus.session.close()  # type: ignore[no-untyped-call]

    def longest_rest_s(self) -> float:
        """In sim's time, without a sample in which a joint moved by more than a milliradian."""
        longest, began = 0.0, self.truth.times[0]
        for (earlier, later), now in zip(pairwise(self.truth.angles), self.truth.times[1:], strict=True):
            if max(abs(a - b) for a, b in zip(earlier, later, strict=True)) > 1e-3:
                began = now
            longest = max(longest, now - began)
        return longest


def follows(status: dict[str, Any]) -> bool:
    """Whether the arm is where its target is, now; how many frames a second is another question."""
    return bool(status.get("state") == "moving" and status["rate_hz"] > 2 and (status["error_m"] or 9) < 0.3)


@pytest.fixture(scope="module")
def compose() -> Iterator[Compose]:
    compose = Compose()
    compose("--profile", "camera", "build", timeout_s=BUILD_S)
    compose("up", "--detach", "--wait")
    yield compose
    compose("down", "--volumes", "--timeout", "5")


def test_arm_follows_its_target_in_containers(compose: Compose) -> None:
    status = compose.wait_until_it_follows(60)
    assert status["mode"] == "track"
    assert status["rate_hz"] > 5


def test_page_is_served_to_this_machine(compose: Compose) -> None:
    address = f"http://127.0.0.1:{compose.environment['ARMSIGHT_PAGE_PORT']}"
    with urllib.request.urlopen(address, timeout=10) as answer:
        assert b"viser" in answer.read().lower()


def test_the_solvers_run_compiled_though_the_image_has_no_compiler(compose: Compose) -> None:
    ask = "from armsight_control.solvers.packages import prepare; print(*prepare(), sep='\\n')"
    backends, trouble = compose("exec", "-T", "control", "python3", "-c", ask).split("\n")[:2]
    assert trouble == ""
    assert backends.count("compiled") == len(backends.split(", ")) == 4


@pytest.mark.parametrize("victims", [(), ("router",), ("sim",), ("vision",), ("control",)], ids=" ".join)
def test_restart_while_moving_holds_the_arm_and_it_goes_on(compose: Compose, victims: tuple[str, ...]) -> None:
    compose.wait_until_it_follows(60)
    with Watch(compose.environment["ARMSIGHT_PORT"]) as watch:
        compose("restart", "--timeout", "5", *victims)
        compose("up", "--detach", "--wait")
        compose.wait_until_it_follows(60)
    if victims not in ((), ("sim",)):  # another sim is another arm
        if victims != ("router",):  # without a router nobody sees it hold
            assert watch.longest_rest_s() > 0.3, "the arm did not hold"
        watch.truth.assert_speed_below(5.0)


@pytest.mark.parametrize("victim", ["router", "sim", "vision", "control"])
def test_killed_container_comes_back_and_the_arm_goes_on(compose: Compose, victim: str) -> None:
    compose.wait_until_it_follows(60)
    compose("kill", "--signal", "KILL", victim)
    compose("up", "--detach", "--wait")
    compose.wait_until_it_follows(60)


def test_a_frozen_vision_holds_the_arm_and_it_goes_on_afterwards(compose: Compose) -> None:
    compose.wait_until_it_follows(60)
    compose("pause", "vision")
    try:
        time.sleep(1.0)
        frozen = compose.status()
    finally:
        compose("unpause", "vision")
    assert not follows(frozen)
    compose.wait_until_it_follows(60)


@pytest.mark.parametrize("victim", ["control", "sim"])
def test_a_container_off_the_network_comes_back_to_it(compose: Compose, victim: str) -> None:
    compose.wait_until_it_follows(60)
    network, container = f"{PROJECT}_bus", compose.container(victim)
    docker("network", "disconnect", network, container)
    try:
        time.sleep(2.0)
        assert not follows(compose.status())
    finally:
        docker("network", "connect", "--alias", victim, network, container)
    compose.wait_until_it_follows(60)


def test_memory_that_runs_out_in_one_container_is_its_own_affair(compose: Compose) -> None:
    compose.wait_until_it_follows(60)
    before = compose.container("control")
    greedy = "b = bytearray(); [b.extend(bytes(1 << 24)) for _ in range(1 << 10)]"
    ended = compose.run("exec", "-T", "control", "python3", "-c", greedy, timeout_s=60)
    assert ended.returncode != 0, "16 GiB in a container of 1"
    compose("up", "--detach", "--wait")
    compose.wait_until_it_follows(60)
    assert compose.container("control") == before, "restarted, not made anew"


def test_two_robots_have_nothing_of_each_other(compose: Compose) -> None:
    assert_two_robots_have_nothing_of_each_other(compose)


def assert_two_robots_have_nothing_of_each_other(compose: Compose) -> None:
    compose("--profile", "two-robots", "up", "--detach", "--wait")
    try:
        compose.wait_until_it_follows(60)
        compose.wait_until_it_follows(60, SECOND)
        compose("exec", "-T", "operator", "armsight", "mode", "hold", "--namespace", SECOND)
        time.sleep(1.0)
        assert compose.status(SECOND)["mode"] == "hold"
        assert compose.wait_until_it_follows(60)["mode"] == "track"
    finally:
        compose("--profile", "two-robots", "rm", "--stop", "--force", "sim-2", "vision-2", "control-2")


def test_vision_measures_what_cameras_in_a_container_bring(
    compose: Compose, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compose.wait_until_it_follows(60)
    port = compose.environment["ARMSIGHT_PORT"]
    snapshot = [str(EXECUTABLE), "snapshot", str(tmp_path / "camera"), "--connect", f"tcp/127.0.0.1:{port}"]
    subprocess.run(snapshot, timeout=30, check=True, capture_output=True)
    for name in ("1", "2"):
        (tmp_path / "camera" / name).mkdir()
        (tmp_path / "camera" / f"camera-{name}.png").rename(tmp_path / "camera" / name / "0.png")
    tmp_path.chmod(0o755)  # the container is somebody else's
    monkeypatch.setitem(compose.environment, "ARMSIGHT_EXTERNAL_CAMERAS", "1 2")
    monkeypatch.setitem(compose.environment, "ARMSIGHT_CAMERA_FOLDER", str(tmp_path / "camera"))
    monkeypatch.setitem(compose.environment, "ARMSIGHT_CAMERA", "--device /camera/1 --device /camera/2 --loop")
    for device in ("ARMSIGHT_VIDEO_1", "ARMSIGHT_VIDEO_2"):
        monkeypatch.setitem(compose.environment, device, "/dev/null")
    compose("--profile", "camera", "up", "--detach", "--wait")
    try:
        deadline = time.monotonic() + 60
        while True:
            states = {service["name"]: service for service in compose.status()["services"]}
            if {states.get(name, {}).get("status") for name in ("sim", "vision", "camera")} == {"ok"}:
                break
            assert time.monotonic() < deadline, states
        # what the camera took before it had heard sim's clock is on another, and refused; health says so in a second
        await_frames(compose, 45, deadline)
        ahead = counted(compose, "command_refused_future", "sim")
        await_frames(compose, 45, deadline)
        assert counted(compose, "command_refused_future", "sim") == ahead
        assert compose("exec", "-T", "camera", "id", "-u").strip() == "10001"
    finally:
        compose("--profile", "camera", "rm", "--stop", "--force", "camera")
        monkeypatch.undo()
        compose("up", "--detach", "--wait", "--remove-orphans")
    compose.wait_until_it_follows(60)


def test_frames_come_by_shared_memory_where_it_is_shared(compose: Compose) -> None:
    assert counted(compose, "frames_by_shared_memory") == 0
    files = ("--file", "docker-compose.yml", "--file", "docker-compose.shm.yml")
    compose(*files, "up", "--detach", "--wait")
    try:
        compose.wait_until_it_follows(60)
        assert counted(compose, "frames_by_shared_memory") > 10
    finally:
        compose("up", "--detach", "--wait", "--remove-orphans")
    compose.wait_until_it_follows(60)


@pytest.mark.parametrize(
    ("differs", "who", "reason"),
    [
        ({"sim": {"ulimits": {"memlock": 65536}}}, "sim", "ulimit -l"),
        ({"router": {"volumes": ["little:/dev/shm"]}}, "router", "--shm-size"),
        ({"vision": {"user": "10002:10002"}}, "", ""),
    ],
    ids=["little may be locked", "little room", "another user's"],
)
def test_where_shared_memory_cannot_be_had_frames_come_all_the_same(
    compose: Compose, tmp_path: Path, differs: dict[str, Any], who: str, reason: str
) -> None:
    little = {"little": {"driver_opts": {"type": "tmpfs", "device": "tmpfs", "o": "size=64k,mode=1777"}}}
    override = tmp_path / "differs.json"
    override.write_text(json.dumps({"services": differs, "volumes": little}), encoding="ascii")
    files = ("docker-compose.yml", "docker-compose.shm.yml", str(override))
    compose(*(word for file in files for word in ("--file", file)), "up", "--detach", "--wait")
    try:
        compose.wait_until_it_follows(60)
        assert counted(compose, "frames_received") > 10
        assert counted(compose, "frames_by_shared_memory") == 0
        if who:
            assert reason in compose("logs", who)
    finally:
        compose("up", "--detach", "--wait", "--remove-orphans")
    compose.wait_until_it_follows(60)


def test_with_certificates_the_arm_moves_and_nobody_without_one_is_let_in(
    compose: Compose, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(compose.environment, "ARMSIGHT_CERTIFICATES", str(tmp_path))
    monkeypatch.setitem(compose.environment, "ARMSIGHT_USER", f"{os.getuid()}:{os.getgid()}")
    monkeypatch.setitem(compose.environment, "COMPOSE_FILE", "docker-compose.yml:docker-compose.secure.yml")
    compose("run", "--rm", "certs")
    assert (tmp_path / "sim" / "key.pem").stat().st_mode & 0o777 == 0o600
    compose("up", "--detach", "--wait")
    try:
        compose.wait_until_it_follows(60)
        port = compose.environment["ARMSIGHT_PORT"]
        status = [str(EXECUTABLE), "status", "--json", "--connect", f"tls/127.0.0.1:{port}"]
        mine = tmp_path / "operator" / "zenoh.json5"
        inside = subprocess.run(
            [*status, "--zenoh-config", str(mine)], capture_output=True, text=True, timeout=30, check=False
        )
        assert follows(json.loads(inside.stdout)), inside.stderr
        outside = subprocess.run(status, capture_output=True, text=True, timeout=30, check=False)
        assert outside.returncode != 0
        assert "certificate" in outside.stderr
        secret = (tmp_path / "control" / "key.pem").read_text(encoding="ascii").splitlines()[1]
        assert secret not in compose("logs") + docker("inspect", compose.container("control"))
    finally:
        monkeypatch.undo()
        compose("up", "--detach", "--wait", "--remove-orphans")
    compose.wait_until_it_follows(60)


def counted(compose: Compose, counter: str, by: str = "vision") -> int:
    """By a service's own health."""
    its = next(service for service in compose.status()["services"] if service["name"] == by)
    return int(its["counters"].get(counter, 0))


def await_frames(compose: Compose, more: int, deadline_s: float) -> None:
    """Until vision has received so many more."""
    before = counted(compose, "frames_received")
    while counted(compose, "frames_received") < before + more:
        assert time.monotonic() < deadline_s, compose.status()


def docker(*words: str) -> str:
    ended = subprocess.run(["docker", *words], capture_output=True, text=True, timeout=UP_S, check=False)
    assert ended.returncode == 0, f"docker {' '.join(words)}: {ended.stderr}"
    return ended.stdout


@pytest.mark.parametrize("image", IMAGES)
def test_nobody_in_an_image_can_become_another_compile_or_replace_a_program(compose: Compose, image: str) -> None:
    del compose  # which builds them

    def found(script: str) -> list[str]:
        return docker("run", "--rm", "--entrypoint", "sh", f"armsight/{image}", "-c", script).split()

    assert found("find / -xdev -type f -perm /6000 2>/dev/null; true") == []
    assert found("for each in gcc g++ cc clang rustc cargo; do command -v $each; done; true") == []
    writable = "-perm -o+w -o -user armsight"
    temporary = ("/proc", "/sys", "/dev", "/tmp", "/var/tmp", "/run/lock", "/recordings")  # noqa: S108
    kept = " -o ".join(f"-path {path}" for path in temporary)
    assert found(f"find / \\( {kept} \\) -prune -o ! -type l \\( {writable} \\) -print 2>/dev/null; true") == []
    assert found("command -v python3 || command -v armsight-vision") != [], "the look inside does find things"


def test_no_container_runs_as_root_or_can_write_to_its_image(compose: Compose) -> None:
    for service in ("router", "sim", "vision", "control", "operator", "page"):
        assert compose("exec", "-T", service, "id", "-u").strip() == "10001", service
        write = compose.run("exec", "-T", service, "touch", "/usr/local/file")
        assert write.returncode != 0, service


def test_a_full_disk_ends_the_recording_and_nothing_else(compose: Compose, tmp_path: Path) -> None:
    small = tmp_path / "small.yml"
    small.write_text(
        "volumes: {recordings: {driver_opts: {type: tmpfs, device: tmpfs, o: 'size=8m,mode=1777'}}}\n", encoding="ascii"
    )
    words = ("--file", "docker-compose.yml", "--file", str(small), "--profile", "record")
    holder = f"{PROJECT}-holder"  # what is in memory is gone when nobody has it open
    compose.wait_until_it_follows(60)
    try:
        compose(*words, "run", "--detach", "--no-deps", "--name", holder, "recorder", "sleep", "600")
        compose(*words, "up", "--detach", "--no-deps", "recorder")
        deadline = time.monotonic() + 240
        while "No space left on device" not in (said := compose(*words, "logs", "recorder")):
            assert time.monotonic() < deadline, said
            time.sleep(1.0)
        assert "can't go on writing" in said
        status = compose.wait_until_it_follows(10)
        assert {s["name"]: s["status"] for s in status["services"]}["control"] == "ok"
        found = docker("exec", holder, "sh", "-c", "ls /recordings/*.mcap").split()
        info = json.loads(docker("exec", holder, "armsight", "recording", "info", "--json", found[0]))
        assert info["complete"], info["troubles"]
        assert info["lost"] == 0
        assert info["keys"]["camera/1/image"]["count"] > 30
        assert info["bytes"] > 4_000_000
        assert info["notes"]["armsight end"]["why"] == "no room"
    finally:
        compose(*words, "rm", "--stop", "--force", "recorder")
        subprocess.run(["docker", "rm", "--force", holder], capture_output=True, timeout=UP_S, check=False)
        subprocess.run(
            ["docker", "volume", "rm", f"{PROJECT}_recordings"], capture_output=True, timeout=UP_S, check=False
        )


def test_the_recorder_is_well_and_what_it_recorded_stays(compose: Compose, tmp_path: Path) -> None:
    words = ("--profile", "record")
    compose.wait_until_it_follows(60)
    try:
        compose(*words, "up", "--detach", "--wait")
        time.sleep(5.0)
        assert "recorder" in {service["name"] for service in compose.status()["services"]}
        compose(*words, "stop", "recorder")
        read = "armsight recording info --json /recordings/*.mcap"
        info = json.loads(compose(*words, "run", "--rm", "--no-deps", "recorder", "sh", "-c", read))
        assert info["complete"], info["troubles"]
        assert info["lost"] == 0
        assert info["messages"] > 100
        compose(*words, "cp", "recorder:/recordings", str(tmp_path))
        assert list(tmp_path.rglob("*.mcap"))
    finally:
        compose(*words, "rm", "--stop", "--force", "recorder")
