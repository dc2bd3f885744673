"""`armsight router`: the router of the bus in a process of its own."""

import json
import logging
import signal
import threading
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armsight_operator.cli.options import ZenohConfig
from armsight_operator.errors import CertificateError

if TYPE_CHECKING:
    from armsight.session import SessionConfig

log = logging.getLogger(__name__)

_PROBE_S = 2.0


def router(
    listen: Annotated[
        list[str] | None,
        typer.Option(
            "--listen",
            metavar="ENDPOINT",
            help="Where to listen, may be given again. [default: the Zenoh file's, else tcp/127.0.0.1:7447]",
            show_default=False,
        ),
    ] = None,
    health: Annotated[bool, typer.Option("--health", help="Only ask whether one runs there.")] = False,
    insecure_bind: Annotated[
        bool,
        typer.Option(
            "--insecure-bind",
            help="Listen where other machines connect, though without certificates: whoever does moves the arm.",
        ),
    ] = False,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Run the router that every service connects to, until SIGTERM or Ctrl-C.

    Without certificates (`armsight certs make`) it listens on this machine alone, unless --insecure-bind is given.

    Example: armsight router --listen tcp/127.0.0.1:7447
    """
    from armsight_operator.cli.bus import configuration
    from armsight_operator.exposure import check_exposure, reachable_from_here

    config = configuration(None, None, zenoh_config, shared_memory="read")
    endpoints = tuple(listen or _in_file(config.file, "listen/endpoints") or ("tcp/127.0.0.1:7447",))
    if health:
        _probe(replace(config, endpoints=tuple(map(reachable_from_here, endpoints))))
        return
    if not insecure_bind:
        check_exposure(endpoints, mutual_tls=bool(_in_file(config.file, "transport/link/tls/enable_mtls")))
    _run(replace(config, mode="router", endpoints=endpoints, namespace=""))


def _run(config: "SessionConfig") -> None:
    from armsight.logs import set_up_logging
    from armsight.session import open_session
    from armsight_operator.certs.layout import CERTIFICATE
    from armsight_operator.exposure import is_local

    set_up_logging("router", "warning")
    if config.file is not None and (config.file.parent / CERTIFICATE).exists():
        _warn_of_certificates(config.file.parent)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    session = open_session(config, stop)
    if session is None:
        return
    with session:
        who = "this machine only" if all(map(is_local, config.endpoints)) else "other machines, too"
        print(f"router listens on {', '.join(config.endpoints)} ({who})", flush=True)
        stop.wait()


def _warn_of_certificates(folder: Path) -> None:
    from armsight_operator.certs.folder import Folder

    with suppress(CertificateError):  # not of our making: Zenoh may well take it
        for entry in Folder(folder).entries():
            if entry.trouble:
                log.warning("the certificate of %s: %s", entry.name, entry.trouble)


def _probe(config: "SessionConfig") -> None:
    from armsight_operator.cli.bus import connected

    with connected(config, timeout_s=_PROBE_S):
        print(f"a router answers at {', '.join(config.endpoints)}")


def _in_file(file: Path | None, path: str) -> Any:
    if file is None:
        return None
    import zenoh

    return json.loads(zenoh.Config.from_file(str(file)).get_json(path))
