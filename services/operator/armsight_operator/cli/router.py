"""`armsight router`: the router of the bus in a process of its own."""

import json
import logging
import threading
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armsight.stopping import stop_on_signals
from armsight_operator.cli.options import ZenohConfig
from armsight_operator.errors import CertificateError

if TYPE_CHECKING:
    import zenoh

    from armsight.session import SessionConfig

log = logging.getLogger(__name__)

_PROBE_S = 2.0
_LOOK_S = 2.0
"""Between looks at whether links to other routers are up."""


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
    connect: Annotated[
        list[str] | None,
        typer.Option(
            "--connect",
            metavar="ENDPOINT",
            help="Another router to link this one to, may be given again. [default: the Zenoh file's, else none]",
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

    Robot and operator on two machines, a router on each, that of the robot linked to the operator's (docs/deploy.md):
    armsight router --zenoh-config certs/edge/zenoh.json5 --connect tls/center.local:7447

    Example: armsight router --listen tcp/127.0.0.1:7447
    """
    from armsight.session import DEFAULT_ENDPOINT, endpoints_in_file
    from armsight_operator.cli.bus import configuration
    from armsight_operator.exposure import check_exposure, reachable_from_here

    config = configuration(None, None, zenoh_config, shared_memory="read")
    file = config.file
    endpoints = tuple(listen or (file and endpoints_in_file(file, "listen", "router")) or (DEFAULT_ENDPOINT,))
    links = tuple(connect or (file and endpoints_in_file(file, "connect", "router")) or ())
    if health:
        _probe(replace(config, endpoints=tuple(map(reachable_from_here, endpoints))))
        return
    if not insecure_bind:
        mutual_tls = bool(_in_file(config.file, "transport/link/tls/enable_mtls"))
        check_exposure(endpoints, mutual_tls=mutual_tls, links=links)
    _run(replace(config, mode="router", endpoints=endpoints, links=links, namespace=""))


def _run(config: "SessionConfig") -> None:
    from armsight.endpoints import is_local
    from armsight.logs import set_up_logging
    from armsight.session import open_session
    from armsight_operator.certs.layout import CERTIFICATE

    set_up_logging("router", "warning")
    if config.file is not None and (config.file.parent / CERTIFICATE).exists():
        _warn_of_certificates(config.file.parent)
    stop = stop_on_signals()
    session = open_session(config, stop)
    if session is None:
        return
    with session:
        who = "this machine only" if all(map(is_local, config.endpoints)) else "other machines, too"
        linked = f", linked to {', '.join(config.links)}" if config.links else ""
        print(f"router listens on {', '.join(config.endpoints)} ({who}){linked}", flush=True)
        if config.links:
            _watch_links(session, config, stop)
        stop.wait()


def _watch_links(session: "zenoh.Session", config: "SessionConfig", stop: threading.Event) -> None:
    """Says when there is no other router, and why; Zenoh itself tries again and again without a word."""
    from armsight.session import refusal

    there = ", ".join(config.links)
    was_linked: bool | None = None
    while not stop.wait(_LOOK_S):
        is_linked = bool(session.info.routers_zid())
        if is_linked != was_linked and not is_linked:
            reason = refusal(replace(config, endpoints=config.links)) or "is it running, and is the network up?"
            log.warning("no link to a router at %s, still trying: %s", there, reason)
        elif is_linked and was_linked is False:
            log.warning("linked to a router at %s again", there)
        was_linked = is_linked


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
