"""A fleet at one router."""

import resource
import threading
from contextlib import ExitStack

import pytest

from armsight.session import SessionConfig, open_session
from armsight_operator.stack import Stack

FLEET = 1100
"""More than Zenoh lets in by itself."""


@pytest.mark.untimed
def test_a_router_lets_in_more_than_a_thousand() -> None:
    gave_up = threading.Event()
    timer = threading.Timer(60.0, gave_up.set)
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    assert limits[1] > 2 * FLEET, "a machine of a fleet allows a process that many descriptors"
    with Stack() as stack, ExitStack() as closing:
        resource.setrlimit(resource.RLIMIT_NOFILE, (1024, limits[1]))  # as a login has it: Zenoh raises it
        closing.callback(resource.setrlimit, resource.RLIMIT_NOFILE, limits)
        stack.start("router")
        resource.setrlimit(resource.RLIMIT_NOFILE, (limits[1], limits[1]))
        timer.start()
        closing.callback(timer.cancel)
        for index in range(FLEET):
            robot = SessionConfig(endpoints=(stack.endpoint,), namespace=f"robots/{index}", shared_memory="off")
            session = open_session(robot, gave_up)
            assert session is not None, f"the router let in {index}"
            closing.callback(session.close)
            assert list(session.info.routers_zid())
