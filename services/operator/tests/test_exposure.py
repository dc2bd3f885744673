"""A router without certificates listens on its own machine alone, unless it is told otherwise."""

import subprocess
import sys
from pathlib import Path

import pytest

from armsight.endpoints import is_local
from armsight_operator.cli.app import main
from armsight_operator.errors import InsecureBindError
from armsight_operator.exposure import check_exposure, check_host_exposure, reachable_from_here
from armsight_operator.stack import free_port
from secure_bus import SecureBus

LOCAL = ["tcp/127.0.0.1:7447", "tcp/127.8.8.8:7447", "tcp/localhost:1", "tcp/[::1]:7447", "unixsock-stream//tmp/x"]
OPEN = [
    *("tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/192.168.1.2:7447", "tcp/robot.local:7447", "ws/0.0.0.0:1"),
    *("tcp/[::ffff:10.0.0.1]:7447", "vsock/1:7447", "serial//dev/ttyUSB0", "tcp/0.0.0.0:1#enable_mtls=true"),
]
WITH_CERTIFICATES = ["tls/0.0.0.0:7447", "quic/[::]:7447?rel=1", "tls/0.0.0.0:7447#close_link_on_expiration=false"]
BY_ITSELF_WITHOUT = [
    "tls/0.0.0.0:7447#enable_mtls=false",
    "quic/[::]:7447?rel=1#close_link_on_expiration=true;enable_mtls=false",
    "tls/0.0.0.0:7447#enable_mtls=true;enable_mtls=false",
    "tls/0.0.0.0:7447#enable_mtls",
]


@pytest.mark.parametrize("endpoint", LOCAL)
def test_loopback_needs_no_certificates(endpoint: str) -> None:
    assert is_local(endpoint)
    check_exposure([endpoint], mutual_tls=False)


@pytest.mark.parametrize("endpoint", OPEN)
def test_network_without_certificates_is_refused(endpoint: str) -> None:
    for mutual_tls in (False, True):  # certificates elsewhere in the configuration don't help a plain endpoint
        with pytest.raises(InsecureBindError, match="--insecure-bind"):
            check_exposure([LOCAL[0], endpoint], mutual_tls=mutual_tls)


@pytest.mark.parametrize("endpoint", WITH_CERTIFICATES)
def test_network_with_certificates_is_allowed_when_both_sides_show_theirs(endpoint: str) -> None:
    check_exposure([endpoint], mutual_tls=True)
    with pytest.raises(InsecureBindError):
        check_exposure([endpoint], mutual_tls=False)


@pytest.mark.parametrize("endpoint", BY_ITSELF_WITHOUT)
def test_endpoint_that_asks_for_no_certificates_is_refused_whatever_the_file_says(endpoint: str) -> None:
    with pytest.raises(InsecureBindError):
        check_exposure([endpoint], mutual_tls=True)
    local = endpoint.replace("0.0.0.0", "127.0.0.1").replace("[::]", "[::1]")  # noqa: S104
    check_exposure([local], mutual_tls=False)


@pytest.mark.parametrize("command", [("page",), ("metrics",), ("bridge", "foxglove")])
@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.2", "robot.local", ""])  # noqa: S104
def test_what_asks_nobody_who_they_are_is_for_this_machine_alone(
    command: tuple[str, ...], host: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main([*command, "--host", host])
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert "--insecure-bind" in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost"])
def test_this_machine_alone_needs_no_leave(host: str) -> None:
    check_host_exposure(host, "it", "nothing")


def test_endpoint_that_asks_for_certificates_itself_is_allowed() -> None:
    check_exposure(["tls/0.0.0.0:7447#enable_mtls=true"], mutual_tls=False)


@pytest.mark.parametrize(
    ("listens", "connects"),
    [
        ("tcp/0.0.0.0:7447", "tcp/127.0.0.1:7447"),
        ("tls/[::]:7447", "tls/[::1]:7447"),
        ("tls/0.0.0.0:7447?rel=1#iface=eth0", "tls/127.0.0.1:7447"),
        ("tls/router:7447", "tls/router:7447"),
        ("tcp/10.0.0.1:7447", "tcp/10.0.0.1:7447"),
    ],
)
def test_health_is_asked_where_the_machine_reaches_itself(listens: str, connects: str) -> None:
    assert reachable_from_here(listens) == connects


def listens(*flags: str) -> str:
    """What a router says first, on its way out or when it listens."""
    command = [sys.executable, "-c", "from armsight_operator.cli.app import main; main()", "router", *flags]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdout is not None
    try:
        return process.stdout.readline()
    finally:
        process.terminate()
        process.communicate(timeout=5)


def test_router_refuses_and_listens_when_told_to() -> None:
    port = free_port()
    assert "whoever connects moves the arm" in listens("--listen", f"tcp/0.0.0.0:{port}")
    assert "(other machines, too)" in listens("--listen", f"tcp/0.0.0.0:{port}", "--insecure-bind")
    assert "(this machine only)" in listens("--listen", f"tcp/127.0.0.1:{port}")


def test_router_listens_where_its_file_says_and_not_where_zenoh_would(tmp_path: Path) -> None:
    port = free_port()
    file = tmp_path / "zenoh.json5"
    file.write_text(f'{{listen: {{endpoints: {{router: ["tcp/127.0.0.1:{port}"]}}}}}}', encoding="utf-8")
    assert f"router listens on tcp/127.0.0.1:{port} " in listens("--zenoh-config", str(file))
    file.write_text("{}", encoding="utf-8")
    assert "tcp/127.0.0.1:7447" in listens("--zenoh-config", str(file))  # and says so, whether or not it is free
    file.write_text('{listen: {endpoints: {router: ["tcp/0.0.0.0:7447"]}}}', encoding="utf-8")
    assert "whoever connects moves the arm" in listens("--zenoh-config", str(file))


def test_refusal_is_a_mistake_of_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["router", "--listen", "tcp/0.0.0.0:7447"])
    assert ended.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_router_says_when_its_certificate_expires_soon(tmp_path: Path) -> None:
    secure = SecureBus(tmp_path)
    flags = ["--listen", secure.endpoint, "--zenoh-config", str(secure.file("router"))]
    assert listens(*flags).startswith("router listens on")
    secure.folder.renew(["router"], days=10)
    assert "the certificate of router: expires in 9 days" in listens(*flags)


def test_router_with_certificates_listens_anywhere_and_answers_for_its_health(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    secure = SecureBus(tmp_path)
    everywhere = secure.endpoint.replace("127.0.0.1", "0.0.0.0")  # noqa: S104
    flags = ["--listen", everywhere, "--zenoh-config", str(secure.file("router"))]
    assert "(other machines, too)" in listens(*flags)
    secure.start_router()
    try:
        with pytest.raises(SystemExit) as ended:
            main(["router", "--health", *flags])
    finally:
        secure.close()
    assert not ended.value.code
    assert "a router answers at" in capsys.readouterr().out
