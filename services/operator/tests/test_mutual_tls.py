"""Who has no certificate of ours does not get in, and is told why; who has one does."""

import dataclasses
import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import serialization

from armsight import topics
from armsight.errors import ConfigError
from armsight.session import SessionConfig, open_session, refusal, zenoh_settings
from armsight_operator.certs import authority
from armsight_operator.certs.folder import Folder
from armsight_operator.cli.app import main
from secure_bus import HOST, SecureBus, an_hour_ago, certify, gets_in

PLAIN_SERVICE = """
import argparse, sys
from armsight.service import add_service_arguments, run_service
parser = argparse.ArgumentParser()
add_service_arguments(parser)
sys.exit(run_service("sim", parser.parse_args(), {}, lambda context: context.stop.wait() and None))
"""


@pytest.fixture
def secure(tmp_path: Path) -> Iterator[SecureBus]:
    secure = SecureBus(tmp_path / "certs")
    yield secure
    secure.close()


@pytest.fixture
def router(secure: SecureBus) -> SecureBus:
    secure.start_router()
    return secure


def said_by_the_command_line(config: SessionConfig, capsys: pytest.CaptureFixture[str]) -> str:
    file = [] if config.file is None else ["--zenoh-config", str(config.file)]
    with pytest.raises(SystemExit) as ended:
        main(["stop", "--connect", config.endpoints[0], *file])
    assert ended.value.code == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


def test_own_certificate_gets_in(router: SecureBus) -> None:
    for name in ("sim", "vision", "control", "operator", "viewer"):
        assert gets_in(router.config(name), tries=10), name
    assert refusal(router.config("sim")) == ""


def test_no_certificate_no_connection(router: SecureBus, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trusting = tmp_path / "trusting.json5"
    ca = router.folder.path / "sim/ca.pem"
    trusting.write_text(f'{{transport: {{link: {{tls: {{root_ca_certificate: "{ca}"}}}}}}}}', encoding="utf-8")
    config = SessionConfig(endpoints=(router.endpoint,), shared_memory="off", file=trusting)
    assert not gets_in(config)
    assert "the router wants a certificate, and we show none" in said_by_the_command_line(config, capsys)


def test_plain_connection_is_none(router: SecureBus) -> None:
    plain = SessionConfig(endpoints=(router.endpoint.replace("tls/", "tcp/"),), shared_memory="off")
    assert not gets_in(plain)
    assert f"connect to {router.endpoint} with --zenoh-config" in refusal(plain)


def test_certificate_of_another_authority_does_not_get_in(router: SecureBus, tmp_path: Path) -> None:
    stranger = SecureBus(tmp_path / "strange")
    config = stranger.config("operator", router.endpoint)
    assert not gets_in(config)
    assert "the router's certificate is not signed by our CA" in refusal(config)
    # nor one that trusts the router's authority and is not of it
    certify(router.folder, "operator", stranger.folder.path, datetime.now(UTC) + timedelta(hours=1))
    assert not gets_in(router.config("operator"))
    error = refusal(router.config("operator"))
    assert "is not signed by the router's CA" in error
    assert str(router.folder.path / "operator/certificate.pem") in error


def test_expired_certificate_does_not_get_in(router: SecureBus, capsys: pytest.CaptureFixture[str]) -> None:
    assert gets_in(router.config("operator"), tries=10)
    certify(router.folder, "operator", router.folder.path, an_hour_ago())
    assert not gets_in(router.config("operator"))
    error = said_by_the_command_line(router.config("operator"), capsys)
    assert "has expired: `armsight certs renew`" in error
    router.folder.renew(["operator"], days=1)
    assert gets_in(router.config("operator"), tries=10)


def test_expired_router_is_not_joined(secure: SecureBus) -> None:
    certify(secure.folder, "router", secure.folder.path, an_hour_ago())
    secure.start_router()
    assert not gets_in(secure.config("operator"))
    assert "the router's certificate has expired" in refusal(secure.config("operator"))


def test_router_of_another_host_is_not_joined(secure: SecureBus) -> None:
    other = Folder(secure.folder.path)
    (other.path / "router/certificate.pem").unlink()
    other.make({"router": "router"}, ["elsewhere.local"], days=1, ca_days=1)
    secure.start_router()
    assert not gets_in(secure.config("operator"))
    assert f"the router's certificate is not for {HOST}" in refusal(secure.config("operator"))


@pytest.mark.parametrize("bearer", ["sim", HOST])
def test_service_certificate_does_not_pass_for_the_routers(secure: SecureBus, bearer: str) -> None:
    # somebody with sim's key listens where the router should, or with a key whose bearer is named as the router's host
    ca = secure.folder._authority()
    key = authority.make_key()
    made = authority.sign(ca, key.public_key(), bearer, "sim", [bearer], days=1)
    (secure.folder.path / "router/key.pem").write_bytes(authority.to_pem(key))
    (secure.folder.path / "router/certificate.pem").write_bytes(made.public_bytes(serialization.Encoding.PEM))
    secure.start_router()
    assert not gets_in(secure.config("operator"))
    assert f"what listens at {HOST} has no router's certificate" in refusal(secure.config("operator"))


def test_router_without_tls_is_told_from_one_that_is_not_there(
    secure: SecureBus, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "start the stack with `armsight up`" in said_by_the_command_line(secure.config("operator"), capsys)
    plain = SessionConfig(
        mode="router", endpoints=(secure.endpoint.replace("tls/", "tcp/"),), namespace="", shared_memory="off"
    )
    session = open_session(plain, threading.Event())
    assert session is not None
    with session:
        assert "speaks no TLS" in said_by_the_command_line(secure.config("operator"), capsys)


def test_waiting_service_logs_what_to_do(router: SecureBus) -> None:
    certify(router.folder, "sim", router.folder.path, an_hour_ago())
    command = [sys.executable, "-c", PLAIN_SERVICE, "--connect", router.endpoint]
    process = subprocess.Popen(
        [*command, "--zenoh-config", router.file("sim")], stderr=subprocess.PIPE, text=True, env=os.environ
    )
    assert process.stderr is not None
    try:
        line = process.stderr.readline()
        assert "has expired" in line
        assert "armsight certs renew" in line
        # it waits, and joins as soon as it has a certificate again
        router.folder.renew(["sim"], days=1)
        presence = router.bus("control").presence()
        deadline = time.monotonic() + 10
        while "sim" not in presence.alive():
            assert time.monotonic() < deadline, "it did not join"
            time.sleep(0.05)
    finally:
        process.terminate()
        process.communicate(timeout=5)


@pytest.mark.parametrize("file", ["ca.pem", "certificate.pem", "key.pem"])
def test_missing_file_is_an_error_at_once(secure: SecureBus, file: str) -> None:
    path = secure.folder.path / "sim" / file
    assert zenoh_settings(secure.config("sim"))
    path.unlink()
    with pytest.raises(ConfigError, match=f"{file} is missing or can't be read"):
        open_session(secure.config("sim"), threading.Event())


def test_configuration_works_from_any_folder(router: SecureBus, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(router.folder.path.parent)
    relative = dataclasses.replace(router.config("sim"), file=router.file("sim").relative_to(Path.cwd()))
    assert gets_in(relative, tries=10)
    (router.folder.path / "sim").rename(router.folder.path / "elsewhere")
    assert gets_in(dataclasses.replace(relative, file=Path("certs/elsewhere/zenoh.json5")), tries=10)


def test_nothing_secret_is_logged(
    router: SecureBus, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    secret = (router.folder.path / "sim/key.pem").read_text(encoding="ascii").splitlines()[1]
    caplog.set_level(logging.DEBUG)
    router.bus("sim")
    certify(router.folder, "sim", router.folder.path, an_hour_ago())
    assert not gets_in(router.config("sim"))
    reason = refusal(router.config("sim"))
    assert "has expired" in reason
    settings = str(zenoh_settings(router.config("sim")))
    captured = capfd.readouterr()
    for text in (caplog.text, captured.out, captured.err, reason, settings):
        assert secret not in text


def test_expiry_ends_a_connection_and_renewal_keeps_it(secure: SecureBus) -> None:
    # setup: two connections whose certificates expire soon; one is renewed in time
    expires = datetime.now(UTC).replace(microsecond=0) + timedelta(seconds=4)
    for name in ("sim", "control"):
        certify(secure.folder, name, secure.folder.path, expires)
    secure.start_router()
    tokens = [
        secure.bus(name).session.liveliness().declare_token(topics.HEALTH.key_for(name)) for name in ("sim", "control")
    ]
    watcher = secure.bus("control").presence()
    secure.folder.renew(["control"], days=1)
    deadline = time.monotonic() + 5
    while watcher.alive() != {"sim", "control"}:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    # fault: the old certificates expire
    while datetime.now(UTC) < expires:
        time.sleep(0.05)
    # invariant: within a second the renewed one is back, the other is not
    watching = secure.bus("control").presence()
    deadline = time.monotonic() + 5
    while watching.alive() != {"control"}:
        assert time.monotonic() < deadline, watching.alive()
        time.sleep(0.02)
    time.sleep(1.0)
    assert watching.alive() == {"control"}
    del tokens


def test_restarted_router_shows_its_renewed_certificate_and_everybody_is_back(secure: SecureBus) -> None:
    # setup: the router's certificate is about to expire, a service publishes
    secure.start_router()
    certify(secure.folder, "router", secure.folder.path, datetime.now(UTC) + timedelta(hours=1))
    publisher = secure.bus("control").publisher(topics.CONTROL_STATUS)
    status = secure.bus("operator").subscriber(topics.CONTROL_STATUS)

    def is_heard(timeout_s: float) -> bool:
        status.clear()
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            publisher.put(topics.CONTROL_STATUS.message(detail="x"))
            if status.recv(0.02) is not None:
                return True
        return False

    assert is_heard(5.0)
    # renewal
    secure.folder.renew([], days=1)
    secure.stop_router()
    assert not is_heard(0.2)
    secure.start_router()
    # recovery, declarations and rights included
    began = time.monotonic()
    assert is_heard(10.0)
    print(f"heard again {time.monotonic() - began:.2f} s after the router's start")
