"""The metrics: their names, units, labels and help. prometheus-client keeps the format."""

from collections.abc import Callable, Iterator, Mapping
from itertools import accumulate
from typing import TypeVar

from prometheus_client import CollectorRegistry, PlatformCollector, ProcessCollector
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    Metric,
    StateSetMetricFamily,
)
from prometheus_client.registry import Collector

from armsight.v1.control_pb2 import ControlMode, ControlState
from armsight_operator.metrics.counted import GAUGES, REPLACED, meaning
from armsight_operator.metrics.routers import Router
from armsight_operator.metrics.watch import BUCKETS_S, Observed, Seen
from armsight_operator.monitor import mode_name, word

STATUSES = ("ok", "waiting", "degraded", "missing", "unspecified", "unknown")
MODES = (*(mode_name(number) for number in ControlMode.values()), "unknown")
STATES = (*(word(ControlState, number, "CONTROL_STATE_") for number in ControlState.values()), "unknown")

_COUNTERS = {
    "frames": ("Frames by how far they came, by the totals of the service that took the step.", ("step",)),
    "refused": ("Messages and requests that a service refused, by what it was and why.", ("what", "reason")),
    "malformed": ("Messages and requests that a service could not decode.", ("what",)),
    "failed": ("Messages and requests that made a service fail.", ("what",)),
    "ik": ("Inverse kinematics that control solved, by how it ended.", ("result",)),
    "safety": ("Answers of control by what safety did to them.", ("code",)),
    "held": ("Answers of control without motion, by why.", ("reason",)),
    "events": ("Everything else that services count, by their own names.", ("event",)),
}
_TOTALS_AMONG_GAUGES = {
    "watchdog_trips": ("sim_watchdog_trips", "Times that no command came in time and the arm braked."),
    "solver_restarts": ("control_solver_restarts", "Times that the solver's process was started again."),
    "frames_unpaired": ("vision_frames_unpaired", "Frames dropped because their partners did not come in time."),
}
_GAUGES = {
    "rate_hertz": "Frames a second of a service, lately, by its own account.",
    "render_seconds": "Drawing the last frames of an instant.",
    "process_seconds": "Measuring the markers of one instant, mean of lately.",
    "solve_seconds": "Inverse kinematics, median of lately.",
    "speed_ratio": "Simulated seconds a second.",
    "stopped": "Whether a stop is in force.",
}

_Labels = TypeVar("_Labels", bound=tuple[str, ...])


class _Collector(Collector):
    def __init__(self, observe: Callable[[], Observed]) -> None:
        self._observe = observe

    def collect(self) -> Iterator[Metric]:
        yield from metrics(self._observe())


def registry(observe: Callable[[], Observed]) -> CollectorRegistry:
    """A registry that asks anew at each scrape; with this process's own memory, time and files beside it."""
    made = CollectorRegistry()
    made.register(_Collector(observe))
    ProcessCollector(namespace="armsight_metrics", registry=made)
    PlatformCollector(registry=made)
    return made


def metrics(seen: Observed) -> Iterator[Metric]:
    """Everything that was observed, as families of metrics."""
    yield _gauge("bus_connected", "Whether this exporter has a router.", {(): float(seen.connected)}, ())
    yield _counter(
        "metrics_ignored",
        "What this exporter left out: names that can't be labels, values that can't be.",
        {(what,): float(total) for what, total in seen.ignored.items()},
        ("what",),
    )
    yield from _of_routers(seen.routers)
    yield from _of_services(seen.services)
    yield from _of_totals(seen)
    yield from _of_gauges(seen.services)
    yield _stages(seen)
    yield _state("control_mode", "What control does; none where it is silent.", MODES, {(): seen.mode}, ())
    yield _state("control_state", "Whether the arm is commanded; none where silent.", STATES, {(): seen.state}, ())
    error = {} if seen.error_m is None else {(): seen.error_m}
    yield _gauge("target_error_metres", "Estimated tip to target; absent where there is no target.", error, ())
    stops = {} if seen.stopped_by is None else {(): float(seen.stopped_by)}
    yield _gauge("stop_sources", "How many stop the arm now; absent where sim never said.", stops, ())


def _of_routers(routers: tuple[Router, ...]) -> Iterator[Metric]:
    versions = {(router.name, router.version): 1.0 for router in routers}
    yield _gauge("router_info", "A router and its Zenoh's version; always 1.", versions, ("router", "version"))
    sessions = {(router.name, kind): float(count) for router in routers for kind, count in router.sessions.items()}
    yield _gauge("router_sessions", "Who is connected to a router, by kind.", sessions, ("router", "kind"))
    links = {(router.name, name): float(count) for router in routers for name, count in router.links.items()}
    yield _gauge("router_links", "Links of a router's sessions, by protocol.", links, ("router", "protocol"))


def _of_services(services: tuple[Seen, ...]) -> Iterator[Metric]:
    def each(value: Callable[[Seen], float | None]) -> dict[tuple[str, ...], float]:
        return {(one.state.name,): told for one in services if (told := value(one)) is not None}

    name = ("service",)
    up = each(lambda one: float(one.state.status != "missing"))
    yield _gauge("service_up", "Whether a service reported its health in the last 2.5 s.", up, name)
    statuses = {(one.state.name,): one.state.status for one in services}
    yield _state("service_status", "How a service says it is.", STATUSES, statuses, name)
    ages = each(lambda one: one.age_s)
    yield _gauge("service_health_age_seconds", "Since a service last reported its health.", ages, name)
    started = each(lambda one: one.started_s or None)
    yield _gauge("service_start_time_seconds", "Start of a service, Unix time by its own clock.", started, name)
    restarts = each(lambda one: float(one.restarts))
    yield _counter("service_restarts", "Times that a service came back as another process.", restarts, name)
    versions = {(one.state.name, one.version): 1.0 for one in services if one.version}
    yield _gauge("service_version_info", "Version of a service; always 1.", versions, ("service", "version"))


def _of_totals(seen: Observed) -> Iterator[Metric]:
    values: dict[str, dict[tuple[str, ...], float]] = {name: {} for name in _COUNTERS}
    for one in seen.services:
        for counter, total in one.totals.items():
            if counter not in _TOTALS_AMONG_GAUGES:
                means = meaning(one.state.name, counter)
                labels = (one.state.name, *means.labels)
                values[means.metric][labels] = values[means.metric].get(labels, 0.0) + total
    values["frames"][("sim", "drawn")] = seen.drawn
    for metric, (text, labels) in _COUNTERS.items():
        yield _counter(metric, text, values[metric], ("service", *labels))
    for counter, (metric, text) in _TOTALS_AMONG_GAUGES.items():
        totals = {(one.state.name,): one.totals[counter] for one in seen.services if counter in one.totals}
        yield _counter(metric, text, totals, ("service",))


def _of_gauges(services: tuple[Seen, ...]) -> Iterator[Metric]:
    values: dict[str, dict[tuple[str, ...], float]] = {name: {} for name in _GAUGES}
    others: dict[tuple[str, ...], float] = {}
    for one in services:
        if one.state.status == "missing":
            continue  # what it said is no longer so
        for name, value in one.gauges.items():
            if (known := GAUGES.get(name)) is not None:
                values[known.metric][(one.state.name,)] = value * known.factor
            elif name not in REPLACED:
                others[(one.state.name, name)] = value
    for metric, text in _GAUGES.items():
        yield _gauge(metric, text, values[metric], ("service",))
    yield _gauge(
        "service_gauge", "Everything else that services measure, by their names.", others, ("service", "gauge")
    )


def _stages(seen: Observed) -> Metric:
    family = HistogramMetricFamily(
        "armsight_stage_latency_seconds",
        "Time of one frame in each stage, by the services' own clocks; frame_to_command is the whole.",
        labels=["stage"],
    )
    ends = [*(f"{end:g}" for end in BUCKETS_S), "+Inf"]
    for stage, (counts, sum_s) in seen.stages.items():
        family.add_metric([stage], list(zip(ends, accumulate(counts), strict=True)), sum_s)
    return family


def _counter(name: str, text: str, values: Mapping[_Labels, float], labels: tuple[str, ...]) -> Metric:
    family = CounterMetricFamily(f"armsight_{name}", text, labels=labels)
    for of, value in values.items():
        family.add_metric(of, value)
    return family


def _gauge(name: str, text: str, values: Mapping[_Labels, float], labels: tuple[str, ...]) -> Metric:
    family = GaugeMetricFamily(f"armsight_{name}", text, labels=labels)
    for of, value in values.items():
        family.add_metric(of, value)
    return family


def _state(
    name: str, text: str, states: tuple[str, ...], now: Mapping[_Labels, str], labels: tuple[str, ...]
) -> Metric:
    family = StateSetMetricFamily(f"armsight_{name}", text, labels=labels)
    for of, state in now.items():
        family.add_metric(of, {one: one == state for one in states})
    return family
