"""The page's process: where it listens, whom it answers, how it ends, and what it costs while nobody looks."""

import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from armsight import topics
from armsight.bus import Bus
from armsight_operator.errors import PortInUseError
from armsight_operator.exposure import is_own_page
from armsight_operator.page.server import Server, check_bindable
from armsight_operator.stack import free_port
from fake_arm import FakeArm
from secure_bus import SecureBus

COMMAND = [sys.executable, "-c", "from armsight_operator.cli.app import main; main()", "page"]


@pytest.fixture
def server() -> Iterator[Server]:
    with Server("127.0.0.1", 0) as server:
        yield server


def get(url: str, **headers: str) -> int:
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=5) as answer:  # noqa: S310
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return error.code


def cpu_s(pid: int) -> float:
    """Processor time that a process used so far."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / 100


@pytest.mark.parametrize(
    ("host", "origin", "own"),
    [
        ("127.0.0.1:7448", "http://127.0.0.1:7448", True),
        ("localhost:9", "http://localhost:9", True),
        ("[::1]:9", "http://[::1]:9", True),
        ("10.0.0.7:9", "http://10.0.0.7:9", True),
        ("127.0.0.1:7448", None, True),
        ("Robot:9", "http://robot:9", True),
        ("127.0.0.1:7448", "http://127.0.0.1:3000", False),  # another page of this machine
        ("127.0.0.1:7448", "https://evil.example", False),
        ("127.0.0.1:7448", "null", False),
        ("evil.example:7448", "http://evil.example:7448", False),  # whose name was given our address
        ("", None, False),
        ("[", "http://[", False),
    ],
)
def test_only_pages_of_its_own_may_connect(host: str, origin: str | None, own: bool) -> None:
    assert is_own_page(host, origin, {"localhost", "robot"}) == own


def test_other_sites_in_the_browser_get_nothing(server: Server) -> None:
    assert get(server.address) == 200
    assert get(server.address, Host="evil.example") == 403
    protocol = [Subprotocol(f"viser-v{viser.__version__}")]
    socket_address = server.address.replace("http", "ws")
    with pytest.raises(InvalidStatus, match="403"):
        connect(socket_address, origin="http://evil.example", subprotocols=protocol)  # type: ignore[arg-type]
    with connect(socket_address, origin=server.address, subprotocols=protocol) as own:  # type: ignore[arg-type]
        assert own.recv(timeout=5)


def test_nobody_shares_the_page_with_the_internet(server: Server) -> None:
    assert server.viser.request_share_url() is None


def test_a_port_that_is_taken_is_said_clearly(server: Server) -> None:
    with pytest.raises(PortInUseError, match=f":{server.port} \\(.*--port"):
        Server("127.0.0.1", server.port)


@pytest.mark.parametrize("host", ["999.1.1.1", "no such host", "203.0.113.7"])
def test_an_address_that_is_not_ours_is_said_clearly(host: str) -> None:
    with pytest.raises(Exception, match=r"is no address|can't be served"):
        check_bindable(host, 0)


@pytest.fixture
def page(endpoint: str) -> Iterator["subprocess.Popen[str]"]:
    """`armsight page` on a free port; its first line is read."""
    process = subprocess.Popen(
        [*COMMAND, "--port", "0", "--connect", endpoint], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline().startswith("the page is at http://127.0.0.1:")
    yield process
    process.kill()
    process.communicate()


def test_sigterm_ends_it_soon_and_quietly(page: "subprocess.Popen[str]") -> None:
    began = time.monotonic()
    page.send_signal(signal.SIGTERM)
    out, error = page.communicate(timeout=5)
    assert time.monotonic() - began < 2.0
    assert (page.returncode, out, error) == (0, "", "")


def test_it_is_a_service_like_the_others(
    page: "subprocess.Popen[str]", make_bus: Callable[[], Bus], endpoint: str
) -> None:
    health = make_bus().subscriber(topics.HEALTH, "page").recv(5.0)
    assert health is not None
    assert dict(health.message.gauges) == {"viewers": 0.0}
    asked = subprocess.run([*COMMAND, "--health", "--connect", endpoint], capture_output=True, text=True, check=False)
    assert (asked.returncode, asked.stderr) == (0, "")
    page.terminate()
    page.communicate(timeout=5)
    asked = subprocess.run([*COMMAND, "--health", "--connect", endpoint], capture_output=True, text=True, check=False)
    assert asked.returncode == 1


def test_without_viewers_it_listens_to_nothing_that_flows(
    page: "subprocess.Popen[str]", make_bus: Callable[[], Bus]
) -> None:
    bus = make_bus()
    flows = [topic for topic in topics.TOPICS if topic.delivery != "latched"]
    publishers = {topic.name: bus.publisher(topic, "1" if "{name}" in topic.key else None) for topic in flows}
    arm = FakeArm(bus)  # what is said once it does hear
    time.sleep(1.0)
    assert [name for name, publisher in publishers.items() if publisher.has_subscribers()] == []
    before = cpu_s(page.pid)
    for _ in range(30):
        arm.say_status()
        time.sleep(0.1)
    assert cpu_s(page.pid) - before < 0.3, "a tenth of a processor is not nothing"


def test_with_certificates_it_is_an_operator_and_nothing_else_will_do(tmp_path: Path) -> None:
    secure = SecureBus(tmp_path)
    secure.start_router()
    try:
        health = secure.bus("viewer").subscriber(topics.HEALTH, "page")
        started = [*COMMAND, "--port", "0", "--zenoh-config"]
        with subprocess.Popen([*started, str(secure.file("operator"))], stdout=subprocess.PIPE) as page:
            try:
                assert health.recv(20.0) is not None
            finally:
                page.terminate()
        other = subprocess.run(
            [*started, str(secure.file("vision"))], capture_output=True, text=True, timeout=20, check=False
        )
        assert other.returncode == 2
        assert "are for vision, this is operator" in other.stderr
    finally:
        secure.close()


def test_a_taken_port_is_a_mistake_of_the_command_line(endpoint: str) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", free_port()))
        other.listen()
        port = str(other.getsockname()[1])
        ended = subprocess.run(
            [*COMMAND, "--port", port, "--connect", endpoint], capture_output=True, text=True, timeout=20, check=False
        )
    assert ended.returncode == 2
    assert f"127.0.0.1:{port}" in ended.stderr
