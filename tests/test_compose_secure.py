"""The stack with certificates in containers: who is refused and why, two robots, two machines, what is reachable."""

import json
import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path
from threading import Event

import pytest
from test_compose import BUILD_S, Compose, assert_two_robots_have_nothing_of_each_other, docker

from armsight import topics
from armsight.bus import Bus, open_bus
from armsight.service import EXIT_CONFIG
from armsight.session import SessionConfig, open_session
from armsight.times import to_duration, to_timestamp
from armsight.v1.joints_pb2 import JointCommand
from armsight_operator.certs.folder import Folder
from armsight_operator.stack import free_port
from secure_bus import an_hour_ago, certify

HERE = "172.17.0.1"
"""This machine on Docker's default network: where containers of another project reach it."""

SECURE = "docker-compose.yml:docker-compose.secure.yml"
BUS = ("router", "sim", "vision", "control", "operator")

pytestmark = [pytest.mark.docker, pytest.mark.timeout(BUILD_S + 300)]


def environment(certificates: Path, *files: str) -> dict[str, str]:
    return {
        "COMPOSE_FILE": ":".join((SECURE, *files)),
        "ARMSIGHT_SIM": "",  # as it comes, with all its frames
        "ARMSIGHT_CERTIFICATES": str(certificates),
        "ARMSIGHT_USER": f"{os.getuid()}:{os.getgid()}",
    }


def wait_for_log(compose: Compose, service: str, text: str) -> None:
    deadline = time.monotonic() + 40
    while text not in (said := compose("logs", "--since", "60s", service)):
        assert time.monotonic() < deadline, f"{service} does not say {text!r}: {said[-2000:]}"
        time.sleep(0.5)


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    return Folder(tmp_path_factory.mktemp("certs"))


@pytest.fixture(scope="module")
def secure(certificates: Folder) -> Iterator[Compose]:
    compose = Compose("armsight-secure-test", **environment(certificates.path))
    compose("build", timeout_s=BUILD_S)
    make = [*json.loads(compose("--profile", "certs", "config", "--format", "json"))["services"]["certs"]["command"]]
    compose("run", "--rm", "certs", *make, "--name=wall=viewer", "--router=edge=sim,vision", f"--host={HERE}")
    compose("up", "--detach", "--wait")
    yield compose
    compose("--profile", "*", "down", "--volumes", "--timeout", "5")


def as_bearer(compose: Compose, folder: Path, *words: str) -> tuple[int, str]:
    """What a command of somebody with this folder ends with, on the bus's own network."""
    mounted = f"{folder}:/etc/armsight:ro"
    ended = compose.run("run", "--rm", "--no-deps", "--volume", mounted, "operator", *words, timeout_s=60)
    return ended.returncode, ended.stdout + ended.stderr


@pytest.mark.parametrize(
    ("expires", "is_foreign", "reason"),
    [
        (an_hour_ago, False, "has expired: `armsight certs renew`"),
        (lambda: datetime.now(UTC) + timedelta(hours=1), True, "is not signed by the router's CA"),
    ],
    ids=["expired", "another authority's"],
)
def test_service_with_a_bad_certificate_says_so_and_is_back_with_a_good_one(
    secure: Compose,
    certificates: Folder,
    tmp_path: Path,
    expires: Callable[[], datetime],
    is_foreign: bool,
    reason: str,
) -> None:
    secure.wait_until_it_follows(60)
    stranger = Folder(tmp_path / "strange")
    stranger.make({"sim": "sim"}, [], days=1, ca_days=1)
    certify(certificates, "control", stranger.path if is_foreign else certificates.path, expires())
    secure("restart", "--timeout", "5", "control")
    wait_for_log(secure, "control", reason)
    assert secure.status()["state"] != "moving"
    # the control run: by itself, as soon as it has one
    (certificates.path / "control/certificate.pem").unlink()
    certificates.make({"control": "control"}, [], days=90, ca_days=90)
    secure.wait_until_it_follows(60)


def test_nobody_without_a_certificate_or_with_anothers_does_anything(secure: Compose, certificates: Folder) -> None:
    code, said = as_bearer(secure, certificates.path / "vision", "armsight", "mode", "hold")
    assert code == 1
    assert "may we ask it" in said
    # the control run; what its exit code says is how well the services are
    _, said = as_bearer(secure, certificates.path / "wall", "armsight", "status", "--json")
    assert '"mode": "track"' in said
    trusting = certificates.path / "trusting"
    trusting.mkdir(exist_ok=True)
    trusting.joinpath("ca.pem").write_bytes((certificates.path / "sim/ca.pem").read_bytes())
    trusting.joinpath("zenoh.json5").write_text('{transport: {link: {tls: {root_ca_certificate: "ca.pem"}}}}')
    code, said = as_bearer(secure, trusting, "armsight", "status")
    assert code == 1
    assert "the router wants a certificate, and we show none" in said
    mounted = f"{certificates.path / 'vision'}:/etc/armsight:ro"
    ended = secure.run("run", "--rm", "--no-deps", "--volume", mounted, "sim", timeout_s=60)
    assert ended.returncode == EXIT_CONFIG
    assert "certificate are for vision" in ended.stdout + ended.stderr
    assert secure.wait_until_it_follows(60)["mode"] == "track"


def test_vision_commands_nothing_and_what_the_contract_does_not_name_goes_nowhere(
    secure: Compose, certificates: Folder
) -> None:
    secure.wait_until_it_follows(60)
    with ExitStack() as places:

        def place(name: str) -> Bus:
            endpoint = f"tls/127.0.0.1:{secure.environment['ARMSIGHT_PORT']}"
            file = certificates.path / name / "zenoh.json5"
            session = open_session(SessionConfig(endpoints=(endpoint,), shared_memory="off", file=file), Event())
            assert session is not None
            return places.enter_context(open_bus(session))

        operator, vision, control = place("operator"), place("vision"), place("control")
        health = operator.subscriber(topics.HEALTH, "sim")

        def refused() -> int:
            until = time.monotonic() + 5
            while (heard := health.recv(2.0)) is None:
                assert time.monotonic() < until, "sim is silent"
            return heard.message.counters["command_refused_stale"]

        ancient = JointCommand(answers=to_timestamp(1_000_000_000), valid_for=to_duration(0.1))
        before = refused()
        vision.publisher(topics.JOINT_COMMAND).put(ancient)
        time.sleep(2.0)
        assert refused() == before
        control.publisher(topics.JOINT_COMMAND).put(ancient)  # the control run
        deadline = time.monotonic() + 10
        while refused() == before:
            assert time.monotonic() < deadline, "control's command did not arrive"
        heard: list[str] = []
        operator.session.declare_subscriber("**", lambda sample: heard.append(str(sample.key_expr)))
        positions = operator.subscriber(topics.JOINT_POSITIONS)
        unlisted = {"joints/unlisted", "joints/positions/more", "mine"}
        for key in unlisted:
            vision.session.put(key, b"?")
            control.session.put(key, b"?")
        assert positions.recv(5.0) is not None  # the control run
        time.sleep(1.0)
        assert "joints/positions" in heard, "what the contract names does come"
        assert not unlisted & set(heard)


def test_viewer_stops_the_arm_and_only_operator_releases_it(secure: Compose, certificates: Folder) -> None:
    secure.wait_until_it_follows(60)
    wall = certificates.path / "wall"
    code, said = as_bearer(secure, wall, "armsight", "stop", "--source", "wall")
    assert code == 0, said
    code, said = as_bearer(secure, wall, "armsight", "release", "--source", "wall")
    assert code == 1
    assert "may we ask it" in said
    assert secure.status()["state"] != "moving"
    secure("exec", "-T", "operator", "armsight", "release", "--source", "wall")
    secure.wait_until_it_follows(60)


def test_nothing_listens_but_the_router_and_nobody_outside_reaches_it(secure: Compose) -> None:
    # 0A: listening; 0100007F and 0B00007F: this container itself, and Docker's resolver
    script = "cat /proc/net/tcp /proc/net/tcp6 | awk '$4 == \"0A\" {print $2}'"
    listening = {name: secure("exec", "-T", name, "sh", "-c", script).split() for name in BUS}
    ports = {
        name: [int(each[-4:], 16) for each in found if not each.startswith(("0100007F", "0B00007F"))]
        for name, found in listening.items()
    }
    assert ports == {name: [7447] if name == "router" else [] for name in BUS}
    # published for this machine, not for others
    port = int(secure.environment["ARMSIGHT_PORT"])
    socket.create_connection(("127.0.0.1", port), 2).close()
    with pytest.raises(OSError, match=r"refused|timed out"):
        socket.create_connection((HERE, port), 2)
    # containers of others don't reach the bus's network; those on it do
    address = docker(
        *("inspect", "--format", "{{range .NetworkSettings.Networks}}{{.IPAddress}}{{end}}"), secure.container("router")
    ).strip()
    connect = f"import socket; socket.create_connection(('{address}', 7447), 2)"
    secure("exec", "-T", "control", "python3", "-c", connect)
    docker("run", "--rm", "armsight/operator", "python3", "-c", "import socket")
    with pytest.raises(AssertionError, match=r"TimeoutError|timed out|refused|unreachable"):
        docker("run", "--rm", "armsight/operator", "python3", "-c", connect)


def test_two_robots_with_certificates(secure: Compose) -> None:
    assert_two_robots_have_nothing_of_each_other(secure)


def test_two_machines_with_a_router_each(secure: Compose, certificates: Folder) -> None:
    secure("stop", "--timeout", "5")
    port = str(free_port())
    center = Compose(
        "armsight-center-test",
        **environment(certificates.path, "docker-compose.center.yml"),
        ARMSIGHT_BIND=HERE,
        ARMSIGHT_PORT=port,
    )
    edge = Compose(
        "armsight-edge-test",
        **environment(certificates.path, "docker-compose.edge.yml"),
        ARMSIGHT_CENTER=HERE,
        ARMSIGHT_CENTER_PORT=port,
    )
    try:
        edge("up", "--detach", "--wait")
        wait_for_log(edge, "router", "no link to a router")
        center("up", "--detach", "--wait")
        center.wait_until_it_follows(60)
        wait_for_log(edge, "router", "again")
        center("restart", "--timeout", "5", "router")
        center.wait_until_it_follows(60)
    finally:
        for machine in (center, edge):
            machine("down", "--volumes", "--timeout", "5")
    secure("up", "--detach", "--wait")
    secure.wait_until_it_follows(60)
