"""What the names of a service's counters and gauges mean: which metric, which labels, which unit."""

import re
from dataclasses import dataclass

TOTALS_AMONG_GAUGES = ("watchdog_trips", "solver_restarts", "frames_unpaired")
"""Gauges that only grow, from zero at a service's start."""

FRAMES = {
    ("vision", "instants_answered"): "measured",
    ("control", "answered"): "answered",
    ("sim", "command_move"): "applied",
    ("sim", "command_hold"): "held",
}
"""Counters that say how far frames came. What `control` holds is answered, too, and counted in its own words."""

_REFUSED = re.compile(r"(?:(?P<what>[a-z0-9_]+?)_)?refused(?:_(?P<reason>[a-z0-9_]+))?")
_PREFIXES = ("malformed", "failed", "ik", "safety", "held")


@dataclass(frozen=True, slots=True)
class Meaning:
    """A metric without its prefix, and its labels beside the service."""

    metric: str
    labels: tuple[str, ...] = ()


def meaning(service: str, counter: str) -> Meaning:
    """What a counter counts.

    ``command_refused_stale`` is refused: command, stale. ``refused_stop``, a query, is refused: stop, request.
    """
    if (step := FRAMES.get((service, counter))) is not None:
        return Meaning("frames", (step,))
    if (found := _REFUSED.fullmatch(counter)) is not None:
        what, reason = found["what"], found["reason"]
        if what is None:
            return Meaning("refused", (reason or "unknown", "request"))
        return Meaning("refused", (what, reason or "invalid"))
    prefix, _, rest = counter.partition("_")
    if prefix in _PREFIXES and rest:
        return Meaning(prefix, (rest,))
    return Meaning("events", (counter,))


@dataclass(frozen=True, slots=True)
class Gauge:
    """A metric without its prefix, and what a value is multiplied with for its unit."""

    metric: str
    factor: float = 1.0


GAUGES = {
    "rate_hz": Gauge("rate_hertz"),
    "render_ms": Gauge("render_seconds", 1e-3),
    "process_ms": Gauge("process_seconds", 1e-3),
    "ik_ms": Gauge("solve_seconds", 1e-3),
    "speed": Gauge("speed_ratio"),
    "stopped": Gauge("stopped"),
}
"""What is known by name; the rest is shown under the service's own name for it."""

REPLACED = ("latency_p50_ms", "latency_p99_ms")
"""The histogram of stages says it better."""
