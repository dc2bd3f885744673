"""What routers tell of themselves in Zenoh's admin space: who is connected to each, and by what."""

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import zenoh

from armsight_operator.certs.rights import ROUTERS

_TIMEOUT_S = 0.5
"""They answer in a millisecond or not at all: certificates that may not ask get no answer."""
_MOST = 16
_LONGEST = 64

KINDS = ("client", "peer", "router", "other")
PROTOCOLS = ("tcp", "tls", "quic", "udp", "ws", "unixsock-stream", "other")


@dataclass(frozen=True, slots=True)
class Router:
    """One router at a moment."""

    name: str
    """Zenoh's own, hexadecimal."""
    version: str
    """Of Zenoh."""
    sessions: Mapping[str, int]
    """How many are connected, by their kind: one of :data:`KINDS`."""
    links: Mapping[str, int]
    """Over how many links, by protocol: one of :data:`PROTOCOLS`."""


def ask_routers(session: zenoh.Session) -> tuple[Router, ...]:
    """Every router that answers.

    Args:
        session: without a namespace: the admin space is outside of all.
    """
    found: list[Router] = []
    for reply in session.get(ROUTERS, timeout=_TIMEOUT_S):
        if reply.ok is not None and len(found) < _MOST:
            router = router_of(reply.ok.payload.to_bytes())
            if router is not None:
                found.append(router)
    return tuple(sorted(found, key=lambda router: router.name))


def router_of(payload: bytes) -> Router | None:
    """A router's account of itself; nothing where it is none."""
    try:
        told = json.loads(payload)
        sessions = [session for session in told["sessions"] if isinstance(session, dict)]
        name, version = str(told["zid"])[:_LONGEST], str(told["version"]).split("-")[0][:_LONGEST]
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    links = [link for session in sessions for link in _list(session.get("links"))]
    return Router(
        name,
        version,
        _counted((session.get("whatami") for session in sessions), KINDS),
        _counted((_protocol(link) for link in links), PROTOCOLS),
    )


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _protocol(link: Any) -> str:
    source = link.get("src") if isinstance(link, dict) else None
    return source.partition("/")[0] if isinstance(source, str) else ""


def _counted(values: Any, known: tuple[str, ...]) -> dict[str, int]:
    """Each that is known, and zero of it where there is none: a series that vanishes alarms nobody."""
    counts = Counter(value if isinstance(value, str) and value in known else "other" for value in values)
    return {name: counts[name] for name in known if counts[name] or name in ("client", "peer", "router", "tcp", "tls")}
