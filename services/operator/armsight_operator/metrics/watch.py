"""What was heard on the bus, kept small: the newest health of each service, totals, a histogram of stages."""

import math
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field

import zenoh

from armsight import topics
from armsight.bus import Bus, Received
from armsight.times import NS_PER_S, from_timestamp
from armsight.topics import SERVICES
from armsight.v1.control_pb2 import ControlState, ControlStatus
from armsight.v1.health_pb2 import Health
from armsight.v1.joints_pb2 import JointPositions
from armsight.v1.safety_pb2 import StopState
from armsight.v1.sim_pb2 import Clock
from armsight_operator.metrics.counted import TOTALS_AMONG_GAUGES
from armsight_operator.metrics.names import Ignored, Names
from armsight_operator.metrics.routers import Router, ask_routers
from armsight_operator.metrics.totals import Totals
from armsight_operator.monitor import ServiceState, mode_name, service_state, word
from armsight_operator.trace.stages import STAGES, TOTAL, Frame, Stage, instants_of

BUCKETS_S = (0.0005, 0.001, 0.002, 0.003, 0.005, 0.0075, 0.01, 0.015, 0.02, 0.03, 0.05, 0.075, 0.1, 0.2, 0.5, 1.0)

MOST_SERVICES = 16
MOST_NAMES = 128
"""Of counters and gauges of one service."""

_LONGEST_NAME = 64
_LONGEST_DETAIL = 500

_KEEP = 64
"""Messages that wait: lockstep makes hundreds a second."""
_FRESH_S = 2.5

_OF_VISION = tuple(stage for stage in STAGES if stage.end.startswith("vision_") and not stage.heard)
_OF_CONTROL = (*(stage for stage in STAGES if stage.end.startswith("control_") and not stage.heard), TOTAL)
STAMPED = (*_OF_VISION, *_OF_CONTROL)
"""Stages whose both ends the services themselves tell."""


@dataclass(slots=True)
class Buckets:
    """A histogram: how many in each bucket, the last one without an end."""

    counts: list[int] = field(default_factory=lambda: [0] * (len(BUCKETS_S) + 1))
    sum_s: float = 0.0

    def add(self, seconds: float) -> None:
        """Takes one value."""
        self.counts[next((i for i, end in enumerate(BUCKETS_S) if seconds <= end), len(BUCKETS_S))] += 1
        self.sum_s += seconds


@dataclass(slots=True)
class _Service:
    names: Names = field(default_factory=lambda: Names(MOST_NAMES))
    totals: Totals = field(default_factory=Totals)
    received: Received[Health] | None = None
    instance: str = ""
    restarts: int = 0


@dataclass(frozen=True, slots=True)
class Seen:
    """One service at a moment."""

    state: ServiceState
    gauges: Mapping[str, float]
    totals: Mapping[str, float]
    restarts: int
    age_s: float | None
    """Since its last health; nothing where none came."""
    started_s: float
    """Unix time by its own clock; 0 where it never said."""
    version: str


@dataclass(frozen=True, slots=True)
class Observed:
    """Everything at a moment."""

    connected: bool
    services: tuple[Seen, ...]
    stages: Mapping[str, tuple[tuple[int, ...], float]]
    """Counts by bucket, and the sum in seconds."""
    mode: str
    """Empty where control is silent, as `state`."""
    state: str
    error_m: float | None
    stopped_by: int | None
    drawn: float
    ignored: Mapping[str, int]
    routers: tuple[Router, ...] = ()
    """Those that answer; none where nobody may ask."""


class Watch:
    """Remembers what is heard. :meth:`listen` once there is a bus; :meth:`observe` at any time."""

    def __init__(self) -> None:
        """Has heard nothing yet."""
        self._lock = threading.Lock()
        self._bus: Bus | None = None
        self._outside: zenoh.Session | None = None
        self._admitted = Names(MOST_SERVICES, SERVICES)
        self._services: dict[str, _Service] = {name: _Service() for name in SERVICES}
        self._stages = {stage.name: Buckets() for stage in STAMPED}
        self._drawn = Totals()
        self._status: Received[ControlStatus] | None = None
        self._stop: StopState | None = None
        self._ignored: Ignored = Ignored(
            dict.fromkeys(("service_name", "counter_name", "gauge_name", "gauge_value", "stage_time", "malformed"), 0)
        )

    def listen(self, bus: Bus, outside: zenoh.Session | None = None) -> None:
        """Subscribes: small keys, no images, nothing that a service waits for.

        Args:
            bus: the robot's.
            outside: a session without a namespace, for what routers tell of themselves; none: nobody asks them.
        """
        self._bus, self._outside = bus, outside
        bus.subscriber(topics.HEALTH, "*", on_message=self.take_health)
        bus.subscriber(topics.JOINT_POSITIONS, keep=_KEEP, on_message=self.take_positions)
        bus.subscriber(topics.CONTROL_STATUS, keep=_KEEP, on_message=self.take_status)
        bus.subscriber(topics.CLOCK, on_message=self.take_clock)
        bus.subscriber(topics.STOP_STATE, on_message=self.take_stop)

    def leave(self) -> None:
        """Asks sessions that are about to close for nothing any more."""
        self._bus = self._outside = None

    def connected(self) -> bool:
        """Whether there is a router."""
        bus = self._bus
        return bus is not None and bool(bus.session.info.routers_zid())

    def observe(self) -> Observed:
        """What is known now."""
        now = time.monotonic()
        connected, bus = self.connected(), self._bus
        routers = self._routers() if connected else ()
        malformed = 0 if bus is None else sum(bus.counters.snapshot().values())
        with self._lock:
            fresh = self._status is not None and now - self._status.received_s < _FRESH_S
            status = self._status.message if fresh and self._status is not None else ControlStatus()
            stopped_by = None if self._stop is None else sum(source.stopped for source in self._stop.sources)
            return Observed(
                connected=connected,
                services=tuple(_seen(name, service, now) for name, service in self._services.items()),
                stages={name: (tuple(buckets.counts), buckets.sum_s) for name, buckets in self._stages.items()},
                mode=mode_name(status.mode) if fresh else "",
                state=word(ControlState, status.state, "CONTROL_STATE_") if fresh else "",
                error_m=_error_m(status),
                stopped_by=stopped_by,
                drawn=self._drawn.totals.get("frames", 0.0),
                ignored=dict(self._ignored) | {"malformed": malformed},
                routers=routers,
            )

    def _routers(self) -> tuple[Router, ...]:
        outside = self._outside
        if outside is None:
            return ()
        try:
            return ask_routers(outside)
        except zenoh.ZError:  # closed meanwhile
            return ()

    def take_health(self, received: Received[Health]) -> None:
        """A service's health: its totals go on from what they were."""
        name, health = received.name, received.message
        with self._lock:
            if not self._admitted.admit(name):
                self._ignored["service_name"] += 1
                return
            service = self._services.setdefault(name, _Service())
            instance = health.instance[:_LONGEST_NAME]
            service.restarts += bool(service.instance) and instance != service.instance
            service.instance = instance
            counters = self._bounded(service, health.counters, "counter_name")
            gauges = self._bounded(service, health.gauges, "gauge_name")
            finite = {key: value for key, value in gauges.items() if math.isfinite(value)}
            self._ignored["gauge_value"] += len(gauges) - len(finite)
            grown = {key: value for key in TOTALS_AMONG_GAUGES if (value := finite.pop(key, -1.0)) >= 0}
            service.totals.take(instance, {key: float(value) for key, value in counters.items()} | grown)
            service.received = Received(_kept(health, finite), received.key, name, received.received_s)

    def take_positions(self, received: Received[JointPositions]) -> None:
        """Vision's stages."""
        self._take_stages(Frame(0, instants_of(received.message.stages)), _OF_VISION)

    def take_status(self, received: Received[ControlStatus]) -> None:
        """Control's stages, and what it does."""
        self._take_stages(Frame(0, instants_of(received.message.stages)), _OF_CONTROL)
        with self._lock:
            self._status = received

    def take_clock(self, received: Received[Clock]) -> None:
        """Frames that sim drew. A sim that starts again counts from zero."""
        with self._lock:
            self._drawn.take("", {"frames": float(received.message.frame)})

    def take_stop(self, received: Received[StopState]) -> None:
        """Who stops the arm."""
        with self._lock:
            self._stop = received.message

    def _take_stages(self, frame: Frame, stages: tuple[Stage, ...]) -> None:
        with self._lock:
            for stage in stages:
                took = frame.seconds(stage)
                if took is not None:
                    self._stages[stage.name].add(took)
                self._ignored["stage_time"] += frame.contradicted(stage)

    def _bounded(self, service: _Service, named: Mapping[str, float], what: str) -> dict[str, float]:
        kept: dict[str, float] = {}
        for name, value in named.items():
            if service.names.admit(name):
                kept[name] = value
            else:
                self._ignored[what] += 1
        return kept


def _kept(health: Health, gauges: Mapping[str, float]) -> Health:
    """What is shown of a message, and no more of what somebody may have sent."""
    return Health(
        status=health.status,
        detail=health.detail[:_LONGEST_DETAIL],
        started=health.started,
        version=health.version[:_LONGEST_NAME],
        gauges=gauges,
    )


def _seen(name: str, service: _Service, now: float) -> Seen:
    received = service.received
    health = Health() if received is None else received.message
    return Seen(
        state=service_state(name, received, now),
        gauges=dict(health.gauges),
        totals=dict(service.totals.totals),
        restarts=service.restarts,
        age_s=None if received is None else now - received.received_s,
        started_s=from_timestamp(health.started) / NS_PER_S,
        version=health.version,
    )


def _error_m(status: ControlStatus) -> float | None:
    if not (status.HasField("tip") and status.HasField("target")):
        return None
    tip, target = status.tip, status.target
    return math.dist((tip.x, tip.y, tip.z), (target.x, target.y, target.z))
