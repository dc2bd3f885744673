"""What every Python service does the same way: flags, logs, session, health, parameters, clean shutdown."""

import argparse
import dataclasses
import json
import logging
import sys
import threading
import uuid
from collections.abc import Callable
from typing import Any

from google.protobuf.empty_pb2 import Empty

from armsight.bus import Bus, open_bus
from armsight.counters import Counters
from armsight.errors import ArmsightError, NoReplyError, SessionClosedError
from armsight.logs import set_up_logging
from armsight.parameters import Tunables
from armsight.router_watch import router_watched
from armsight.session import add_session_arguments, check_role, open_session, session_config
from armsight.shared_memory import Use
from armsight.stopping import stop_on_signals
from armsight.times import to_timestamp, wall_ns
from armsight.topics import ASK_PARAMETERS, HEALTH, PARAMETERS, SET_PARAMETERS
from armsight.v1.health_pb2 import HEALTH_STATUS_WAITING, Health, HealthStatus
from armsight.v1.parameters_pb2 import ParametersResponse, SetParametersRequest

log = logging.getLogger(__name__)

HEALTH_PERIOD_S = 1.0
VERSION = "0.1.0"

_PROBE_S = 3.0

EXIT_CONFIG = 2
"""Exit code where flags, environment or files can't be used: starting again does not help."""


class HealthReporter:
    """Publishes this service's health once a second, and at once when its status changes."""

    def __init__(self, service: str, bus: Bus) -> None:
        """Declares the liveliness token and starts publishing."""
        self._service = service
        self._bus = bus
        self._instance = uuid.uuid4().hex[:12]
        self._started = to_timestamp(wall_ns())
        self._lock = threading.Lock()
        self._status: HealthStatus = HEALTH_STATUS_WAITING
        self._detail = "starting"
        self._gauges: dict[str, float] = {}
        self._changed = threading.Event()
        self._publisher = bus.publisher(HEALTH, service)
        self._token = bus.session.liveliness().declare_token(HEALTH.key_for(service))
        self._closing = False
        self._thread = threading.Thread(target=self._publish, name="health", daemon=True)
        self._thread.start()

    def report(self, status: HealthStatus, detail: str = "") -> None:
        """Sets the status and one line that says what is wrong and what to do."""
        with self._lock:
            if (status, detail) == (self._status, self._detail):
                return
            self._status, self._detail = status, detail
        log.info("health", extra={"status": HealthStatus.Name(status), "detail": detail})
        self._changed.set()

    def gauge(self, name: str, value: float) -> None:
        """Sets a current value, such as ``rate_hz``."""
        with self._lock:
            self._gauges[name] = value

    def close(self) -> None:
        """Says how it ends, withdraws the token and stops publishing."""
        self._closing = True
        self._changed.set()
        self._thread.join(timeout=1.0)
        self._token.undeclare()  # type: ignore[no-untyped-call]

    def _publish(self) -> None:
        closing = False
        while not closing:
            closing = self._closing
            with self._lock:
                health = Health(
                    service=self._service,
                    status=self._status,
                    detail=self._detail,
                    instance=self._instance,
                    started=self._started,
                    now=to_timestamp(wall_ns()),
                    counters=self._bus.counters.snapshot(),
                    gauges=self._gauges,
                    version=VERSION,
                )
            self._publisher.put(health)
            if not closing:
                self._changed.wait(HEALTH_PERIOD_S)
                self._changed.clear()


@dataclasses.dataclass(frozen=True, slots=True)
class Context:
    """What a service's body gets: the bus, its health, when to stop, and a place to say what may be set meanwhile."""

    bus: Bus
    health: HealthReporter
    stop: threading.Event
    tunables: Tunables
    shared_memory: Use = "off"
    """What is wanted of it: whether it can be had is asked again by :class:`~armsight.frame_pool.FramePool`."""


def add_service_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the flags that every service has."""
    add_session_arguments(parser)
    parser.add_argument("--health", action="store_true", help="ask the running service whether it answers, and exit")
    parser.add_argument(
        "--log-level", choices=["debug", "info", "warning", "error"], default="warning", help="default: warning"
    )


def run_service(
    name: str,
    arguments: argparse.Namespace,
    parameters: object,
    body: Callable[[Context], None],
    shared_memory: Use = "read",
    role: str | None = None,
) -> int:
    """Runs a service until it ends or SIGTERM or SIGINT asks it to; returns the exit code.

    Args:
        name: the service's name in ``health/{service}``.
        arguments: parsed flags, with those of :func:`add_service_arguments`.
        parameters: a dataclass, the configuration that it starts with, answered on ``{service}/parameters``.
        body: the service itself; returns soon after ``context.stop`` is set.
        shared_memory: see :class:`~armsight.session.SessionConfig`.
        role: whose certificate it shows where the bus asks for one (default: its own name's).
    """
    set_up_logging(name, arguments.log_level)
    if arguments.health:
        return probe(name, arguments)
    stop = stop_on_signals()
    try:
        config = session_config(arguments, shared_memory)
        check_role(config, role or name)
        session = open_session(config, stop)
        if session is None:
            return 0
        with open_bus(session, Counters()) as bus, router_watched(bus):
            health = HealthReporter(name, bus)
            tunables = serve_parameters(name, bus, parameters)
            try:
                body(Context(bus, health, stop, tunables, config.shared_memory))
            except SessionClosedError:
                if not stop.is_set():
                    raise
            finally:
                health.close()
    except ArmsightError as error:
        log.error("%s", error)
        print(f"{name}: {error}", file=sys.stderr)
        return EXIT_CONFIG
    return 0


def probe(name: str, arguments: argparse.Namespace) -> int:
    """Asks a running service for its parameters: 0 when it answers, 1 when not (for container health checks)."""
    stop = threading.Event()
    timer = threading.Timer(_PROBE_S, stop.set)
    timer.daemon = True
    timer.start()
    try:
        session = open_session(session_config(arguments, "off"), stop)
        if session is None:
            raise NoReplyError(f"no router within {_PROBE_S:g} s")
        with open_bus(session) as bus:
            bus.query(ASK_PARAMETERS, Empty(), name, timeout_s=_PROBE_S)
    except ArmsightError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 1
    finally:
        timer.cancel()
    return 0


def serve_parameters(name: str, bus: Bus, parameters: object) -> Tunables:
    """Answers what is in force on ``{service}/parameters``, and takes new values."""
    text = json.dumps(_as_json(parameters), default=str)
    tunables = Tunables(bus.publisher(PARAMETERS, name).put)

    def in_force() -> ParametersResponse:
        return ParametersResponse(json=text, parameters=tunables.messages())

    def change(request: SetParametersRequest) -> ParametersResponse:
        tunables.set(request.values)
        return in_force()

    bus.serve(ASK_PARAMETERS, lambda _: in_force(), name)
    bus.serve(SET_PARAMETERS, change, name)
    return tunables


def _as_json(parameters: object) -> Any:
    if dataclasses.is_dataclass(parameters) and not isinstance(parameters, type):
        return dataclasses.asdict(parameters)
    return parameters
