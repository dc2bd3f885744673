import argparse
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from armsight.errors import ConfigError
from armsight.session import (
    DEFAULT_ENDPOINT,
    DEFAULT_NAMESPACE,
    SessionConfig,
    add_session_arguments,
    check_role,
    open_session,
    session_config,
    zenoh_settings,
)
from armsight.shared_memory import Use

SERVICE = """
import argparse, sys
from armsight.service import add_service_arguments, run_service
from armsight.v1.health_pb2 import HEALTH_STATUS_OK
parser = argparse.ArgumentParser()
add_service_arguments(parser)
def body(context):
    context.health.report(HEALTH_STATUS_OK)
    print("running", flush=True)
    context.stop.wait()
sys.exit(run_service("probe", parser.parse_args(), {}, body))
"""


def parse(*flags: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_session_arguments(parser)
    return parser.parse_args(flags)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "zenoh.json5"
    path.write_text('{ connect: { endpoints: ["tcp/10.0.0.1:1"] }, namespace: "robots/file", /* comment */ }')
    return path


def test_flag_wins_over_environment_over_file_over_default(monkeypatch: pytest.MonkeyPatch, file: Path) -> None:
    for name in ("ARMSIGHT_CONNECT", "ARMSIGHT_NAMESPACE", "ARMSIGHT_ZENOH_CONFIG"):
        monkeypatch.delenv(name, raising=False)
    default = session_config(parse())
    assert (default.endpoints, default.namespace) == ((DEFAULT_ENDPOINT,), DEFAULT_NAMESPACE)
    from_file = session_config(parse("--zenoh-config", str(file)))
    assert (from_file.endpoints, from_file.namespace) == (("tcp/10.0.0.1:1",), "robots/file")
    monkeypatch.setenv("ARMSIGHT_ZENOH_CONFIG", str(file))
    monkeypatch.setenv("ARMSIGHT_CONNECT", "tcp/10.0.0.2:2,tcp/10.0.0.3:3")
    monkeypatch.setenv("ARMSIGHT_NAMESPACE", "robots/env")
    from_env = session_config(parse())
    assert (from_env.endpoints, from_env.namespace) == (("tcp/10.0.0.2:2", "tcp/10.0.0.3:3"), "robots/env")
    from_flags = session_config(parse("--connect", "tcp/h:4", "--namespace", "robots/flag"))
    assert (from_flags.endpoints, from_flags.namespace) == (("tcp/h:4",), "robots/flag")


def test_file_may_hold_a_list_of_endpoints_for_each_mode(tmp_path: Path) -> None:
    path = tmp_path / "zenoh.json5"
    path.write_text('{ connect: { endpoints: { router: ["tcp/r:1"], client: ["tcp/c:2"] } } }')
    assert session_config(parse("--zenoh-config", str(path))).endpoints == ("tcp/c:2",)


@pytest.mark.parametrize(
    "endpoint",
    ["tcp/[::1]:7447", "tls/router.local:7447#so_sndbuf=1", "udp/h:1?rel=0", "unixsock-stream//tmp/armsight"],
)
def test_endpoints_of_every_kind_are_taken(endpoint: str) -> None:
    assert SessionConfig(endpoints=(endpoint,)).endpoints == (endpoint,)


@pytest.mark.parametrize(
    "endpoint",
    [
        "localhost:7447",
        "tcp/",
        "",
        "/x",
        "tcp/h",
        "tcp/:1",
        "tcp/h:",
        "tcp/h:0",
        "tcp/h:65536",
        "tcp/h:²",
        "tls/h:x#a=b",
    ],
)
def test_endpoint_that_is_none_is_refused(endpoint: str) -> None:
    with pytest.raises(ConfigError, match="tcp/HOST:PORT"):
        SessionConfig(endpoints=(endpoint,))


@pytest.mark.parametrize("namespace", ["robots/*", "/robots", "robots//arm", "a#b"])
def test_namespace_that_is_no_key_is_refused(namespace: str) -> None:
    with pytest.raises(ConfigError, match="is not a key"):
        SessionConfig(namespace=namespace)


def test_unreadable_configuration_file_says_which(tmp_path: Path) -> None:
    broken = tmp_path / "broken.json5"
    broken.write_text("{ mode: ")
    with pytest.raises(ConfigError, match=r"broken\.json5"):
        zenoh_settings(SessionConfig(file=broken))


def test_files_of_tls_are_named_relative_to_the_configuration_and_must_be_there(file: Path) -> None:
    file.write_text('{ transport: { link: { tls: { root_ca_certificate: "ca.pem" } } } }')
    with pytest.raises(ConfigError, match=r"root_ca_certificate .*ca\.pem is missing or can't be read"):
        zenoh_settings(SessionConfig(file=file))
    (file.parent / "ca.pem").touch()
    settings = zenoh_settings(SessionConfig(file=file))
    assert json.loads(settings.get_json("transport/link/tls/root_ca_certificate")) == str(file.parent / "ca.pem")


def test_configuration_of_another_service_is_refused(file: Path) -> None:
    config = SessionConfig(file=file)
    for metadata in ("{}", '{ metadata: { role: "sim" } }', '{ metadata: { name: "strawberry" } }'):
        file.write_text(metadata)
        check_role(config, "sim")
    file.write_text('{ metadata: { role: "vision" } }')
    with pytest.raises(ConfigError, match="for vision, this is sim"):
        check_role(config, "sim")


@pytest.mark.parametrize("use", ["publish", "read", "off"])
def test_shared_memory_is_used_as_it_is_wanted(use: Use) -> None:
    settings = zenoh_settings(SessionConfig(shared_memory=use))
    assert json.loads(settings.get_json("transport/shared_memory/enabled")) is (use != "off")
    # a second pool would be more than a process may lock, and frames would vanish without a word
    assert json.loads(settings.get_json("transport/shared_memory/transport_optimization"))["enabled"] is False


@pytest.mark.parametrize(
    ("link", "made"),
    [
        ("tcp/there:7447", "tcp/there:7447#so_sndbuf=32768"),
        ("tls/there:7447#iface=eth0", "tls/there:7447#iface=eth0;so_sndbuf=32768"),
        ("tls/there:7447#so_sndbuf=4194304", "tls/there:7447#so_sndbuf=4194304"),
    ],
)
def test_link_between_routers_holds_back_little_unless_it_says_so(link: str, made: str) -> None:
    settings = zenoh_settings(SessionConfig(mode="router", namespace="", links=(link,)))
    assert json.loads(settings.get_json("connect/endpoints")) == [made]


@pytest.mark.parametrize(
    ("endpoint", "made"),
    [
        ("tcp/127.0.0.1:7447", "tcp/127.0.0.1:7447"),
        ("unixsock-stream//tmp/armsight", "unixsock-stream//tmp/armsight"),
        ("ws/robot.local:7447", "ws/robot.local:7447"),
        ("tcp/robot.local:7447", "tcp/robot.local:7447#so_sndbuf=49152"),
        ("tls/[fd00::1]:7447", "tls/[fd00::1]:7447#so_sndbuf=49152"),
        ("tls/robot.local:7447#so_sndbuf=4194304", "tls/robot.local:7447#so_sndbuf=4194304"),
    ],
)
def test_client_has_little_on_its_way_to_another_machine_unless_it_says_so(endpoint: str, made: str) -> None:
    settings = zenoh_settings(SessionConfig(endpoints=(endpoint,)))
    assert json.loads(settings.get_json("connect/endpoints")) == [made]


def test_port_in_use_is_a_clear_error(endpoint: str) -> None:
    config = SessionConfig(mode="router", endpoints=(endpoint,), namespace="", shared_memory="off")
    first = open_session(config, threading.Event())
    assert first is not None
    with first, pytest.raises(ConfigError, match="can't listen on"):
        open_session(config, threading.Event())


def test_zenoh_log_stays_out_of_what_is_printed(endpoint: str) -> None:
    code = (
        "import threading; from armsight.session import SessionConfig, open_session;"
        f"c = SessionConfig(mode='router', endpoints=('{endpoint}',), namespace='', shared_memory='off');"
        "open_session(c, threading.Event()).close(); print('printed')"
    )
    environment = os.environ | {"RUST_LOG": "zenoh=debug"}
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert run.stdout == "printed\n"
    assert "zenoh" in run.stderr


def run_probe(endpoint: str) -> "subprocess.Popen[str]":
    environment = os.environ | {"ARMSIGHT_CONNECT": endpoint, "ARMSIGHT_SHARED_MEMORY": "off"}
    return subprocess.Popen([sys.executable, "-c", SERVICE], env=environment, stdout=subprocess.PIPE, text=True)


def wait_until_caught(process: "subprocess.Popen[str]", number: int) -> None:
    """Until the process has a handler of its own for a signal."""
    deadline = time.monotonic() + 30
    status = Path(f"/proc/{process.pid}/status")
    while not int(status.read_text().partition("SigCgt:")[2].split()[0], 16) >> (number - 1) & 1:
        assert time.monotonic() < deadline, "the service has not begun"
        time.sleep(0.02)


def test_service_started_before_the_router_joins_when_it_comes(endpoint: str) -> None:
    process = run_probe(endpoint)
    assert process.stdout is not None
    try:
        time.sleep(1.0)
        assert process.poll() is None
        router = open_session(
            SessionConfig(mode="router", endpoints=(endpoint,), namespace="", shared_memory="off"), threading.Event()
        )
        assert router is not None
        with router:
            assert process.stdout.readline() == "running\n"
            process.send_signal(signal.SIGTERM)
            assert process.wait(2.0) == 0
    finally:
        process.kill()
        process.wait()


def test_sigterm_ends_a_service_that_still_waits_for_the_router(endpoint: str) -> None:
    process = run_probe(endpoint)
    try:
        wait_until_caught(process, signal.SIGTERM)
        time.sleep(0.5)
        process.send_signal(signal.SIGTERM)
        assert process.wait(2.0) == 0
    finally:
        process.kill()
        process.wait()
