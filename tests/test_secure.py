"""The whole stack with certificates and rights: it works, and goes on when certificates are renewed."""

import shlex
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path

import pytest
from conftest import MakeRig

from armsight import topics
from armsight.bus import open_bus
from armsight.errors import NoReplyError
from armsight.service import EXIT_CONFIG
from armsight.session import DEFAULT_NAMESPACE, SessionConfig, open_session
from armsight.v1.control_pb2 import SetModeRequest
from armsight.v1.safety_pb2 import STOP_ACTION_RELEASE, STOP_ACTION_STOP, StopRequest
from armsight_operator.certs.configuration import configurations
from armsight_operator.certs.folder import Folder
from armsight_operator.certs.layout import CONFIGURATION, ROUTER
from armsight_operator.stack import Stack, free_port
from rig import SERVICES, Rig, started

ROOT = Path(__file__).parents[1]
BEARERS = {name: name for name in (ROUTER, *SERVICES, "operator", "viewer")}


def ask(armsight: Path, words: list[str], folder: Path) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([armsight, *words], cwd=folder, capture_output=True, text=True, timeout=30, check=False)


def longest_pause(times: list[float]) -> float:
    return max(later - earlier for earlier, later in pairwise(times))


@pytest.fixture(scope="module")
def port() -> int:
    return free_port()


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory, port: int) -> Folder:
    folder = Folder(tmp_path_factory.mktemp("certs"))
    folder.make(BEARERS, ["127.0.0.1"], days=90, ca_days=3650)
    endpoint = [f"tls/127.0.0.1:{port}"]
    for name, text in configurations(BEARERS, endpoint, endpoint, [DEFAULT_NAMESPACE]).items():
        folder.write_configuration(name, text)
    return folder


@pytest.fixture(scope="module")
def shared_secure(tmp_path_factory: pytest.TempPathFactory, certificates: Folder, port: int) -> Iterator[Rig]:
    """One stack for all tests: everything goes over mutual TLS, each with its own rights."""
    with started(Stack(out=tmp_path_factory.mktemp("stack"), port=port, certificates=certificates.path)) as rig:
        yield rig


@pytest.fixture
def secure(shared_secure: Rig) -> Rig:
    """The arm follows the default target."""
    shared_secure.wait_ready()
    shared_secure.mode("track")
    shared_secure.wait_until(shared_secure.moving, 20, "the arm moves")
    return shared_secure


# before the stack of the others: two at once are slow
def test_commands_of_the_documentation_run_the_stack(tmp_path: Path) -> None:
    port = free_port()
    text = (ROOT / "docs/security.md").read_text(encoding="utf-8")
    block = text.split("## Make certificates", 1)[1].split("```sh\n", 1)[1].split("```", 1)[0]
    make, up, status = (shlex.split(line.split("#")[0])[1:] for line in block.splitlines())
    armsight = Path(sys.executable).parent / "armsight"
    at = ["--listen", f"tls/127.0.0.1:{port}", "--connect", f"tls/localhost:{port}"]  # 7447 may be somebody else's
    subprocess.run([armsight, *make, *at], cwd=tmp_path, check=True, timeout=30)
    running = subprocess.Popen([armsight, *up, "--port", str(port)], cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    assert running.stdout is not None
    try:
        assert any(line.startswith("ready after") for line in running.stdout)
        deadline = time.monotonic() + 30
        while "track" not in (said := ask(armsight, status, tmp_path)).stdout or said.returncode != 0:
            assert time.monotonic() < deadline, said.stdout + said.stderr
    finally:
        running.terminate()
        running.wait(10)


def test_arm_follows_its_target_and_obeys(secure: Rig) -> None:
    rate_hz, answered = secure.answered_share(3.0)
    assert rate_hz > 5
    assert answered > 0.5
    secure.stop_arm("test")
    secure.wait_until(lambda: not secure.moving(), 3, "the arm holds")
    secure.release_arm("test")
    secure.wait_until(secure.moving, 20, "the arm moves again")
    secure.mode("joints", (0.3, 0.0, 0.4, 0.2))
    secure.wait_until(lambda: abs(secure.true_joints() - (0.3, 0.0, 0.4, 0.2)).max() < 0.005, 15, "the goal is reached")


def test_viewer_stops_the_arm_and_only_operator_lets_it_go(secure: Rig, certificates: Folder) -> None:
    file = certificates.path / "viewer" / CONFIGURATION
    config = SessionConfig(endpoints=(secure.stack.endpoint,), shared_memory="off", file=file)
    session = open_session(config, threading.Event())
    assert session is not None
    with open_bus(session) as viewer:
        viewer.query(topics.STOP, StopRequest(action=STOP_ACTION_STOP, source="door"))
        secure.wait_until(lambda: not secure.moving(), 3, "the arm holds")
        with pytest.raises(NoReplyError, match="may we ask it"):
            viewer.query(topics.RELEASE, StopRequest(action=STOP_ACTION_RELEASE, source="door"), timeout_s=1.0)
        with pytest.raises(NoReplyError, match="may we ask it"):
            viewer.query(topics.MODE, SetModeRequest(mode="CONTROL_MODE_HOLD"), timeout_s=1.0)
        secure.pause(1.0)
        assert not secure.moving()
    secure.release_arm("door")
    secure.wait_until(secure.moving, 20, "the arm moves again")


def test_renewal_costs_no_more_than_a_restart_of_the_router(secure: Rig, certificates: Folder) -> None:
    commands: list[float] = []
    secure.bus.subscriber(topics.JOINT_COMMAND, keep=1000, on_message=lambda got: commands.append(got.received_s))
    with secure.recording_truth() as truth:
        # while certificates are written nothing happens
        certificates.renew([], days=180)
        secure.pause(1.0)
        assert longest_pause(commands) < 0.5
        # the router takes its own when it starts again
        secure.kill("router")
        began = time.monotonic()
        secure.start("router")
        secure.wait_until(lambda: bool(commands) and commands[-1] > began + 0.1, 20, "commands flow again")
        secure.pause(1.0)
        print(f"no commands for {longest_pause(commands):.2f} s")
        assert longest_pause(commands) < 5.0
        secure.wait_ready()
        secure.wait_until(secure.moving, 20, "the arm moves again")
    # invariant: no joint was ever faster than its limit
    truth.assert_speed_below(5.0)
    assert all(secure.stack.running(name) for name in SERVICES)
    assert min(entry.expires for entry in certificates.entries()) > datetime.now(UTC) + timedelta(days=100)


@pytest.mark.parametrize(("service", "other"), [("sim", "vision"), ("vision", "control"), ("control", "sim")])
def test_service_refuses_anothers_certificate(
    make_rig: MakeRig, certificates: Folder, service: str, other: str
) -> None:
    rig = make_rig(extra={service: ["--zenoh-config", str(certificates.path / other / CONFIGURATION)]})
    rig.start(service)
    process = rig.stack.process(service)
    assert process is not None
    rig.wait_until(lambda: process.poll() is not None, 20, f"{service} ends")
    assert process.poll() == EXIT_CONFIG
    assert "certificate are for" in process.last_line()
    assert f"this is {service}" in process.last_line()


def test_no_log_and_no_environment_holds_a_key(secure: Rig, certificates: Folder) -> None:
    secrets = [file.read_text(encoding="ascii").splitlines()[1] for file in certificates.path.glob("*/key.pem")]
    assert len(secrets) == len(BEARERS) + 1
    seen = ""
    for name in (ROUTER, *SERVICES):
        process = secure.stack.process(name)
        assert process is not None
        for file in ("environ", "cmdline"):
            seen += Path(f"/proc/{process.pid}/{file}").read_text(encoding="utf-8", errors="replace")
        seen += secure.stack.log_file(name).read_text(encoding="utf-8", errors="replace")
    assert CONFIGURATION in seen  # the way to the key, and not the key
    assert not [secret for secret in secrets if secret in seen]
    assert "PRIVATE KEY" not in seen
