import logging
import threading
import time

import pytest
import zenoh

from armsight.bus import Bus, open_bus
from armsight.router_watch import ROUTER_LOST, router_watched
from armsight.session import SessionConfig, open_session


def router(endpoint: str) -> zenoh.Session:
    config = SessionConfig(mode="router", endpoints=(endpoint,), namespace="", shared_memory="off")
    session = open_session(config, threading.Event())
    assert session is not None
    return session


def wait_until_lost(bus: Bus, times: int) -> None:
    deadline = time.monotonic() + 5.0
    while bus.counters.snapshot().get(ROUTER_LOST, 0) < times:
        assert time.monotonic() < deadline, f"{bus.counters.snapshot()}, not lost {times} times"
        time.sleep(0.01)


def test_every_loss_of_the_router_is_counted_and_said(endpoint: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    first = router(endpoint)
    session = open_session(SessionConfig(endpoints=(endpoint,), shared_memory="off"), threading.Event())
    assert session is not None
    with open_bus(session) as bus, router_watched(bus):
        assert ROUTER_LOST not in bus.counters.snapshot()
        first.close()  # type: ignore[no-untyped-call]
        wait_until_lost(bus, 1)
        with router(endpoint):
            deadline = time.monotonic() + 5.0
            while not session.info.routers_zid():
                assert time.monotonic() < deadline
                time.sleep(0.01)
        wait_until_lost(bus, 2)
    said = [record.message.partition(":")[0] for record in caplog.records if record.name == "armsight.router_watch"]
    assert said == ["lost the router", "the router is there again", "lost the router"]


def test_end_of_ones_own_session_is_no_loss(endpoint: str, caplog: pytest.LogCaptureFixture) -> None:
    with router(endpoint):
        session = open_session(SessionConfig(endpoints=(endpoint,), shared_memory="off"), threading.Event())
        assert session is not None
        with open_bus(session) as bus, router_watched(bus):
            pass
        time.sleep(0.2)
        assert ROUTER_LOST not in bus.counters.snapshot()
        assert [record for record in caplog.records if record.name == "armsight.router_watch"] == []
