"""A router without certificates on the loopback interface, and places on its bus."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from armsight.bus import Bus
from armsight.session import DEFAULT_NAMESPACE, SessionConfig, open_session
from armsight_operator.stack import free_port


@contextmanager
def router() -> Iterator[str]:
    """A router's endpoint."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = SessionConfig(mode="router", endpoints=(endpoint,), namespace="", shared_memory="off")
    session = open_session(config, threading.Event())
    assert session is not None
    with session:
        yield endpoint


def opened(endpoint: str, namespace: str = DEFAULT_NAMESPACE) -> Bus:
    """A bus, as every service opens it; its session is the caller's to close."""
    config = SessionConfig(endpoints=(endpoint,), namespace=namespace, shared_memory="off")
    session = open_session(config, threading.Event())
    assert session is not None
    return Bus(session)
