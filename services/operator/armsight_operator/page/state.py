"""What the page says in words: how the arm is and why, how every service is and what to do."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from armsight.topics import SERVICES
from armsight_operator.monitor import ServiceState, Snapshot

Level = Literal["good", "quiet", "warning", "stopped"]

_START = {"sim": "armsight-sim", "vision": "armsight-vision", "control": "armsight-control"}
"""Command of each service of the loop."""

_SAYS: dict[str, tuple[Level, str]] = {
    "moving": ("good", "Moving"),
    "holding": ("quiet", "Holding still"),
    "waiting": ("warning", "Waiting"),
    "blind": ("warning", "Blind: holding still"),
    "stopped": ("stopped", "STOPPED"),
}
"""What control's states are called."""


@dataclass(frozen=True, slots=True)
class Headline:
    """The arm's state in a word, and in a sentence why."""

    level: Level
    title: str
    why: str


@dataclass(frozen=True, slots=True)
class Row:
    """One process: how it is, and what to do where it isn't well."""

    name: str
    status: str
    """``ok``, ``waiting``, ``degraded`` or ``missing``."""
    text: str


def headline(snapshot: Snapshot, *, connected: bool, own_source: str) -> Headline:
    """How the arm is, the most important thing first.

    Args:
        snapshot: what the services say.
        connected: whether there is a router.
        own_source: under which name this page stops.
    """
    if not connected:
        return Headline("warning", "No connection", "no router answers: start the stack with `armsight up`")
    sim = next(service for service in snapshot.services if service.name == "sim")
    if sim.status == "missing":
        return Headline("warning", "No arm", "sim is missing: nothing moves, and nothing can be stopped")
    if snapshot.stopped_by:
        return Headline("stopped", "STOPPED", _why_stopped(snapshot, own_source))
    if not snapshot.mode:
        return Headline("warning", "No control", "control is missing: the arm holds still")
    level, title = _SAYS.get(snapshot.state, ("warning", snapshot.state or "Unknown"))
    distance = "" if snapshot.error_m is None else f"tip {length(snapshot.error_m)} from its target"
    return Headline(level, title, snapshot.detail or distance)


def _why_stopped(snapshot: Snapshot, own_source: str) -> str:
    parts = []
    for name in snapshot.stopped_by:
        reason = snapshot.stop_reasons.get(name, "")
        parts.append(f"by {name}{f' ({reason})' if reason else ''}")
    others = [name for name in snapshot.stopped_by if name != own_source]
    text = ", ".join(parts)
    if others:
        text += "; to let go: " + ", ".join(f"`armsight release --source {name}`" for name in others)
    return text


def rows(snapshot: Snapshot, *, connected: bool, without: Sequence[str] = ()) -> list[Row]:
    """Every process, the router first."""
    router = Row("router", "ok", "") if connected else Row("router", "missing", "start it: `armsight router`")
    return [router, *(_row(service) for service in snapshot.services if service.name not in without)]


def _row(service: ServiceState) -> Row:
    if service.status == "missing":
        start = f"`armsight up` starts it again; alone: `{_START[service.name]}`" if service.name in SERVICES else ""
        return Row(service.name, "missing", f"{service.detail}. {start}".strip(". "))
    rate = service.gauges.get("rate_hz")
    refused = sum(total for name, total in service.counters.items() if "refused" in name or "malformed" in name)
    parts = [
        *([f"{rate:.0f} Hz"] if rate is not None else []),
        *([f"{refused} refused or malformed"] if refused else []),
        *([service.detail] if service.detail else []),
    ]
    return Row(service.name, service.status, ", ".join(parts))


def length(metres: float) -> str:
    """A length for a person: millimetres, from a metre on metres."""
    return f"{metres * 1000:.0f} mm" if metres < 1.0 else f"{metres:.2f} m"
