"""Who may do what on the bus, derived from the contract's table: what the router's access control enforces.

A right is a flow, a message of Zenoh's and the keys on which it may pass. Flows are the router's: what comes in from a
session is ``ingress``, what goes out to it ``egress``. What the table doesn't name passes in neither.
"""

from collections.abc import Iterable, Iterator
from typing import Any, Literal

from armsight.topics import EACH, QUERIES, TOPICS, Query, Topic

ROUTERS = "@/*/router"
"""Where every router tells of itself (Zenoh's admin space): who is connected to it."""
_ASK_ROUTERS = ("operator", "viewer")

Flow = Literal["ingress", "egress"]
Right = tuple[Flow, str]
"""Flow and message."""

_OF_LATCHED = "@adv/pub/**"
"""Under a latched topic's key: its publishers' tokens, caches and heartbeats (zenoh-ext)."""
_ASKED_OF_LATCHED = "@adv/**"
"""Under a latched topic's key: what a late subscriber asks of all caches at once."""


def rights(
    role: str,
    namespaces: Iterable[str],
    topics: Iterable[Topic[Any]] = TOPICS,
    queries: Iterable[Query[Any, Any]] = QUERIES,
    *,
    behind_router: bool = False,
) -> dict[Right, tuple[str, ...]]:
    """The keys on which each message may pass between the router and sessions of one role.

    Args:
        role: one of :data:`armsight.topics.WHO`.
        namespaces: robots that the rights are for.
        topics: rows of the table.
        queries: rows of the table.
        behind_router: the session is another router's, and whoever has the role is connected to that one.
    """
    topics, queries = tuple(topics), tuple(queries)
    relative = [right for topic in topics for right in _of_topic(role, topic)]
    relative += [right for query in queries for right in _of_query(role, query)]
    if behind_router:
        relative += [right for topic in topics for right in _of_topic_behind_router(role, topic)]
        relative += [right for query in queries for right in _of_query_behind_router(role, query)]
    keys: dict[Right, set[str]] = {}
    for namespace in namespaces:
        for flow, message, key in relative:
            keys.setdefault((flow, message), set()).add(f"{namespace}/{key}")
    if role in _ASK_ROUTERS and not behind_router:
        keys.setdefault(("ingress", "query"), set()).add(ROUTERS)
        keys.setdefault(("egress", "reply"), set()).add(ROUTERS)
    return {right: tuple(sorted(keys[right])) for right in sorted(keys)}


def _of_topic(role: str, topic: Topic[Any]) -> Iterator[tuple[Flow, str, str]]:
    latched = topic.delivery == "latched"
    for key in _keys(role, topic.key, topic.publishers):
        yield "ingress", "put", key
        # subscriptions as they were declared, wildcards and all: without hearing of one, a publisher sends nothing
        yield "egress", "declare_subscriber", _any_name(topic.key)
        if topic.watchers:
            yield "ingress", "liveliness_token", key
        if latched:
            yield "ingress", "liveliness_token", f"{key}/{_OF_LATCHED}"
            yield "ingress", "declare_queryable", f"{key}/{_OF_LATCHED}"
            yield "egress", "query", f"{_any_name(topic.key)}/{_ASKED_OF_LATCHED}"
            yield "ingress", "reply", key
            yield "ingress", "put", f"{key}/{_OF_LATCHED}"
            yield "egress", "declare_subscriber", f"{_any_name(topic.key)}/{_OF_LATCHED}"
    for key in _keys(role, topic.key, topic.readers):
        yield "ingress", "declare_subscriber", key
        yield "egress", "put", key
        if latched:
            yield "ingress", "declare_subscriber", f"{key}/{_OF_LATCHED}"
            yield "egress", "put", f"{key}/{_OF_LATCHED}"
            yield "ingress", "declare_liveliness_subscriber", f"{key}/{_OF_LATCHED}"
            yield "egress", "liveliness_token", f"{key}/{_OF_LATCHED}"
            yield "ingress", "query", f"{key}/{_ASKED_OF_LATCHED}"
            yield "egress", "reply", key
    for key in _keys(role, topic.key, topic.watchers):
        yield "ingress", "declare_liveliness_subscriber", key
        yield "egress", "liveliness_token", key


def _of_query(role: str, query: Query[Any, Any]) -> Iterator[tuple[Flow, str, str]]:
    for key in _keys(role, query.key, query.servers):
        yield "ingress", "declare_queryable", key
        yield "egress", "query", key
        yield "ingress", "reply", key
    for key in _keys(role, query.key, query.callers):
        yield "ingress", "query", key
        yield "egress", "reply", key


def _of_topic_behind_router(role: str, topic: Topic[Any]) -> Iterator[tuple[Flow, str, str]]:
    """What a router needs to know to ask for its clients; these know no more than before."""
    if topic.delivery == "latched" and _keys(role, topic.key, topic.readers):
        yield "egress", "declare_queryable", f"{_any_name(topic.key)}/{_OF_LATCHED}"


def _of_query_behind_router(role: str, query: Query[Any, Any]) -> Iterator[tuple[Flow, str, str]]:
    for key in _keys(role, query.key, query.callers):
        yield "egress", "declare_queryable", key


def _keys(role: str, key: str, who: tuple[str, ...]) -> tuple[str, ...]:
    """Somebody who is named may use every name; one of "each" only its own, "operator/page" only page."""
    if role in who:
        return (_any_name(key),)
    own = (role,) if "each" in who and role in EACH else ()
    given = tuple(entry.removeprefix(f"{role}/") for entry in who if entry.startswith(f"{role}/"))
    return tuple(key.replace("{name}", name) for name in own + given)


def _any_name(key: str) -> str:
    return key.replace("{name}", "*")
