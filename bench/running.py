"""A place on the bus of a running stack, and waiting for what it does."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import zenoh

from armsight.bus import Bus, open_bus
from armsight.session import SessionConfig, open_session
from armsight.shared_memory import Use

_PATIENCE_S = 60.0


def session_of(endpoint: str, namespace: str, shared_memory: Use = "off") -> zenoh.Session:
    """A session of one robot; of none where the namespace is empty."""
    config = SessionConfig(endpoints=(endpoint,), namespace=namespace, shared_memory=shared_memory)
    session = open_session(config, threading.Event())
    assert session is not None
    return session


@contextmanager
def bus_of(endpoint: str, namespace: str, shared_memory: Use = "off") -> Iterator[Bus]:
    """A place on one robot's bus."""
    with open_bus(session_of(endpoint, namespace, shared_memory)) as bus:
        yield bus


def until(condition: Callable[[], bool], what: str) -> None:
    """Waits, and looks often: what is timed ends here.

    Raises:
        RuntimeError: it does not become true.
    """
    deadline = time.monotonic() + _PATIENCE_S
    while not condition():
        if time.monotonic() > deadline:
            raise RuntimeError(f"not within {_PATIENCE_S:g} s: {what}")
        time.sleep(0.005)
