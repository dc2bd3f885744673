"""`armsight router`: the router of the bus in a process of its own."""

import json
import signal
import threading
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armsight_operator.cli.options import ZenohConfig

if TYPE_CHECKING:
    from armsight.session import SessionConfig

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
    zenoh_config: ZenohConfig = None,
) -> None:
    """Run the router that every service connects to, until SIGTERM or Ctrl-C."""
    from armsight_operator.cli.bus import configuration

    config = configuration(None, None, zenoh_config, shared_memory="read")
    endpoints = tuple(listen or _listen_in(config.file) or ("tcp/127.0.0.1:7447",))
    if health:
        _probe(replace(config, endpoints=endpoints))
    else:
        _run(replace(config, mode="router", endpoints=endpoints, namespace=""))


def _run(config: "SessionConfig") -> None:
    from armsight.logs import set_up_logging
    from armsight.session import open_session

    set_up_logging("router", "warning")
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    session = open_session(config, stop)
    if session is None:
        return
    with session:
        print(f"router listens on {', '.join(config.endpoints)}", flush=True)
        stop.wait()


def _probe(config: "SessionConfig") -> None:
    from armsight_operator.cli.bus import connected

    with connected(config, timeout_s=_PROBE_S):
        print(f"a router answers at {', '.join(config.endpoints)}")


def _listen_in(file: Path | None) -> list[str]:
    if file is None:
        return []
    import zenoh

    return json.loads(zenoh.Config.from_file(str(file)).get_json("listen/endpoints")) or []
