"""A command's place on the bus: configured like every service's, but not waiting for a router for ever."""

import argparse
import logging
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from armsight.bus import Bus, open_bus
from armsight.session import SessionConfig, open_session, refusal, session_config
from armsight.shared_memory import Use
from armsight_operator.errors import NoRouterError

ROUTER_TIMEOUT_S = 3.0


def configuration(
    connect: Sequence[str] | None,
    namespace: str | None,
    zenoh_config: Path | None,
    shared_memory: Use = "off",
) -> SessionConfig:
    """What flags, environment and file add up to.

    Raises:
        ConfigError: a value that can't be used.
    """
    flags = argparse.Namespace(connect=connect, namespace=namespace, zenoh_config=zenoh_config)
    return session_config(flags, shared_memory)


@contextmanager
def connected(config: SessionConfig, timeout_s: float = ROUTER_TIMEOUT_S) -> Iterator[Bus]:
    """A bus that is closed on leaving.

    Raises:
        NoRouterError: no router answers within the time.
    """
    # One line says it all when there is no router: without the hints that a service logs while it waits.
    logging.getLogger("armsight.session").setLevel(logging.ERROR)
    give_up = threading.Event()
    timer = threading.Timer(timeout_s, give_up.set)
    timer.daemon = True
    timer.start()
    try:
        session = open_session(replace(config, mode="client"), give_up)
    finally:
        timer.cancel()
    if session is None:
        reason = refusal(config) or "start the stack with `armsight up`, or say where it is with --connect"
        raise NoRouterError(f"no router answers at {', '.join(config.endpoints)}: {reason}")
    with open_bus(session) as bus:
        yield bus


@contextmanager
def wait_connected(config: SessionConfig, stop: threading.Event) -> Iterator[Bus | None]:
    """A bus as soon as there is a router; nothing once ``stop`` is set."""
    session = open_session(replace(config, mode="client"), stop)
    if session is None:
        yield None
        return
    with open_bus(session) as bus:
        yield bus
