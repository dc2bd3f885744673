import socket
import threading
from collections.abc import Iterator

import pytest
import zenoh

from armsight.bus import Bus, open_bus
from armsight.session import SessionConfig, open_session


@pytest.fixture
def endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def opened(config: SessionConfig) -> zenoh.Session:
    session = open_session(config, threading.Event())
    assert session is not None
    return session


@pytest.fixture
def router(endpoint: str) -> Iterator[zenoh.Session]:
    with opened(SessionConfig(mode="router", endpoints=(endpoint,), namespace="", shared_memory="off")) as session:
        yield session


@pytest.fixture
def two_buses(router: zenoh.Session, endpoint: str) -> Iterator[tuple[Bus, Bus]]:
    del router
    config = SessionConfig(endpoints=(endpoint,), shared_memory="off")
    with open_bus(opened(config)) as first, open_bus(opened(config)) as second:
        yield first, second
