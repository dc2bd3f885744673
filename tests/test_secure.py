"""The whole stack with certificates and rights: it works, and goes on when certificates are renewed."""

import shlex
import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path

import pytest
from conftest import MakeRig

from armsight import topics
from armsight.service import EXIT_CONFIG
from armsight.session import DEFAULT_NAMESPACE
from armsight_operator.certs.configuration import configurations
from armsight_operator.certs.folder import Folder
from armsight_operator.certs.layout import CONFIGURATION, ROUTER
from armsight_operator.stack import free_port
from rig import SERVICES, Rig

ROOT = Path(__file__).parents[1]
BEARERS = {name: name for name in (ROUTER, *SERVICES, "operator")}


def longest_pause(times: list[float]) -> float:
    return max(later - earlier for earlier, later in pairwise(times))


@pytest.fixture
def port() -> int:
    return free_port()


@pytest.fixture
def certificates(tmp_path: Path, port: int) -> Folder:
    folder = Folder(tmp_path / "certs")
    folder.make(BEARERS, ["127.0.0.1"], days=90, ca_days=3650)
    endpoint = [f"tls/127.0.0.1:{port}"]
    for name, text in configurations(BEARERS, endpoint, endpoint, [DEFAULT_NAMESPACE]).items():
        folder.write_configuration(name, text)
    return folder


@pytest.fixture
def secure(make_rig: MakeRig, certificates: Folder, port: int) -> Rig:
    """The arm follows the default target, everything over mutual TLS and each with its own rights."""
    rig = make_rig(target="default", mode="track", port=port, certificates=certificates.path)
    rig.start_all()
    rig.wait_ready()
    return rig


def test_arm_follows_its_target_and_obeys(secure: Rig) -> None:
    secure.wait_until(secure.moving, 20, "the arm moves")
    rate_hz, answered = secure.answered_share(3.0)
    assert rate_hz > 20
    assert answered > 0.9
    secure.stop_arm("test")
    secure.wait_until(lambda: not secure.moving(), 3, "the arm holds")
    secure.release_arm("test")
    secure.wait_until(secure.moving, 20, "the arm moves again")
    secure.mode("joints", (0.3, 0.0, 0.4, 0.2))
    secure.wait_until(lambda: abs(secure.true_joints() - (0.3, 0.0, 0.4, 0.2)).max() < 0.005, 15, "the goal is reached")


def test_commands_of_the_documentation_run_the_stack(tmp_path: Path, port: int) -> None:
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
        said = subprocess.run(
            [armsight, *status], cwd=tmp_path, capture_output=True, text=True, timeout=30, check=False
        )
        assert said.returncode == 0, said.stderr
        assert "track" in said.stdout
    finally:
        running.terminate()
        running.wait(10)


def test_renewal_costs_no_more_than_a_restart_of_the_router(secure: Rig, certificates: Folder) -> None:
    secure.wait_until(secure.moving, 20, "the arm moves")
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
    secure.wait_until(secure.moving, 20, "the arm moves")
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
