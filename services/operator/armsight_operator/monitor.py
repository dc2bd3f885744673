"""What the services say of themselves, gathered: health, mode, rate, latency, error."""

import math
import threading
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Protocol

from armsight import topics
from armsight.bus import Bus, Received
from armsight.topics import SERVICES
from armsight.v1.control_pb2 import ControlMode, ControlState, ControlStatus
from armsight.v1.health_pb2 import HEALTH_STATUS_OK, Health, HealthStatus
from armsight.v1.safety_pb2 import StopState

MODE_PREFIX = "CONTROL_MODE_"

_STALE_S = 2.5
"""Health comes once a second: two may be lost before a service counts as missing."""
_RATE_WINDOW_S = 2.0
_LATENCIES = 300


@dataclass(frozen=True, slots=True)
class ServiceState:
    """One service as it reported itself last."""

    name: str
    status: str
    """``ok``, ``waiting``, ``degraded`` or ``missing``."""
    detail: str
    counters: dict[str, int] = field(default_factory=dict)
    gauges: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The system at one moment."""

    services: tuple[ServiceState, ...]
    mode: str
    """Empty while control is silent."""
    state: str
    detail: str
    joints: dict[str, float]
    """Estimated, rad."""
    tip: tuple[float, float, float] | None
    """Estimated, base frame, metres."""
    target: tuple[float, float, float] | None
    rate_hz: float
    """Answers of control."""
    latency_p50_ms: float | None
    """Frames sent to command sent."""
    latency_p99_ms: float | None
    stopped_by: tuple[str, ...]
    stop_reasons: dict[str, str] = field(default_factory=dict)
    """What each that stopped the arm gave as its reason, by its name."""

    @property
    def ready(self) -> bool:
        """Whether every service of the loop is well."""
        return all(service.status == "ok" for service in self.services if service.name in SERVICES)

    @property
    def works(self) -> bool:
        """Whether every service of the loop does its work, be it not well: a machine can be too slow for its frames."""
        return all(service.status in ("ok", "degraded") for service in self.services if service.name in SERVICES)

    @property
    def troubles(self) -> tuple[str, ...]:
        """What is not well, a line for each service that says so."""
        return tuple(f"{each.name}: {each.detail or each.status}" for each in self.services if each.status != "ok")

    @property
    def error_m(self) -> float | None:
        """Distance of the estimated tip from the target."""
        return None if self.tip is None or self.target is None else math.dist(self.tip, self.target)


class Monitor:
    """Listens to health, status and stop; the loop notices nothing of it."""

    def __init__(self, bus: Bus) -> None:
        """Subscribes."""
        self._lock = threading.Lock()
        self._health: dict[str, Received[Health]] = {}
        self._status: Received[ControlStatus] | None = None
        self._answers: deque[float] = deque(maxlen=_LATENCIES)
        self._latencies: deque[float] = deque(maxlen=_LATENCIES)
        self._stop: StopState | None = None
        self._subscribers = (
            bus.subscriber(topics.HEALTH, "*", on_message=self._take_health),
            bus.subscriber(topics.CONTROL_STATUS, on_message=self._take_status),
            bus.subscriber(topics.STOP_STATE, on_message=self._take_stop),
        )

    @property
    def status(self) -> ControlStatus | None:
        """Control's last word; nothing while it is silent."""
        with self._lock:
            status = self._status
        fresh = status is not None and time.monotonic() - status.received_s < _STALE_S
        return status.message if fresh and status is not None else None

    def close(self) -> None:
        """Stops listening."""
        for subscriber in self._subscribers:
            subscriber.close()

    def snapshot(self) -> Snapshot:
        """What is known now."""
        now = time.monotonic()
        with self._lock:
            # whoever else is there may leave again: silence of a recorder is no trouble
            others = {name for name, health in self._health.items() if now - health.received_s <= _STALE_S}
            names = [*SERVICES, *sorted(others - set(SERVICES))]
            services = tuple(service_state(name, self._health.get(name), now) for name in names)
            fresh = self._status is not None and now - self._status.received_s < _STALE_S
            status = self._status.message if fresh and self._status is not None else ControlStatus()
            recent = [at for at in self._answers if now - at < _RATE_WINDOW_S]
            latencies = sorted(self._latencies) if fresh else []
            stops = {} if self._stop is None else {s.name: s.reason for s in self._stop.sources if s.stopped}
        has_pose = bool(status.joints) and status.HasField("tip")
        return Snapshot(
            services=services,
            mode=mode_name(status.mode) if fresh and status.mode else "",
            state=word(ControlState, status.state, "CONTROL_STATE_") if fresh else "",
            detail=status.detail,
            joints={joint.name: joint.position_rad for joint in status.joints},
            tip=(status.tip.x, status.tip.y, status.tip.z) if has_pose else None,
            target=(status.target.x, status.target.y, status.target.z) if status.HasField("target") else None,
            rate_hz=len(recent) / _RATE_WINDOW_S,
            latency_p50_ms=_percentile(latencies, 0.50),
            latency_p99_ms=_percentile(latencies, 0.99),
            stopped_by=tuple(stops),
            stop_reasons=stops,
        )

    def _take_health(self, received: Received[Health]) -> None:
        with self._lock:
            self._health[received.name] = received

    def _take_status(self, received: Received[ControlStatus]) -> None:
        with self._lock:
            self._status = received
            self._answers.append(received.received_s)
            stages = received.message.stages
            if stages.frames_sent_ns and stages.control_sent_ns > stages.frames_sent_ns:
                self._latencies.append((stages.control_sent_ns - stages.frames_sent_ns) / 1e6)

    def _take_stop(self, received: Received[StopState]) -> None:
        with self._lock:
            self._stop = received.message


def service_state(name: str, received: Received[Health] | None, now: float) -> ServiceState:
    """What a service's last health means at a time of the monotonic clock, seconds."""
    if received is None or now - received.received_s > _STALE_S:
        return ServiceState(name, "missing", "not heard of" if received is None else "silent: restart it")
    health = received.message
    status = "ok" if health.status == HEALTH_STATUS_OK else word(HealthStatus, health.status, "HEALTH_STATUS_")
    return ServiceState(name, status, health.detail, dict(health.counters), dict(health.gauges))


class Enum(Protocol):
    """An enumeration of protobuf's."""

    def Name(self, number: int) -> str:  # noqa: N802  (protobuf's)
        """The name of a value, or ValueError."""


def word(enum: Enum, value: int, prefix: str) -> str:
    """A value of an enumeration in a person's word; from a newer version it may be one that has none here."""
    try:
        return enum.Name(value).removeprefix(prefix).lower()
    except ValueError:
        return "unknown"


def mode_name(mode: int) -> str:
    """A mode of control as people write it."""
    return word(ControlMode, mode, MODE_PREFIX).replace("_", "-")


def _percentile(ordered: Iterable[float], share: float) -> float | None:
    values = list(ordered)
    return values[min(len(values) - 1, int(share * len(values)))] if values else None
