"""Notices when a session loses its router, and when it has one again: the session itself reconnects silently."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from time import monotonic

import zenoh

from armsight.bus import Bus

log = logging.getLogger(__name__)

ROUTER_LOST = "router_lost"
"""The counter's name in health."""


@contextmanager
def router_watched(bus: Bus) -> Iterator[None]:
    """Counts and says every loss of the router until it is left; leave it before the session is closed."""
    lost_s = monotonic()

    def changed(event: zenoh.TransportEvent) -> None:
        nonlocal lost_s
        if event.transport.whatami != zenoh.WhatAmI.ROUTER:
            return
        if event.kind == zenoh.SampleKind.DELETE:
            lost_s = monotonic()
            total = bus.counters.add(ROUTER_LOST)
            log.warning("lost the router: connecting again until it is there", extra={"total": total})
        else:
            log.warning("the router is there again", extra={"after_s": round(monotonic() - lost_s, 3)})

    listener = bus.session.info.declare_transport_events_listener(changed, history=False)
    try:
        yield
    finally:
        with suppress(zenoh.ZError):  # the session ended by itself, and the listener with it
            listener.undeclare()  # type: ignore[no-untyped-call]
