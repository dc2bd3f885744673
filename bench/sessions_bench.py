"""What a thousand sessions do to one router; writes results/sessions.json.

Each session stands for the control of a robot of its own: it declares the keys that control does, and says its health
once a second. Two processes hold them, beside the router on one machine, so that times are of all three together.
Somebody else's message goes through the same router all the while, there and back.
"""

import multiprocessing
import signal
import statistics
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from multiprocessing.synchronize import Event

import zenoh
from processes import memory, processor_s
from running import session_of, until

from armsight import topics
from armsight_operator.stack import Stack
from results import Result, percentile, publish

COUNTS = (10, 100, 300, 1000)
HOLDERS = 2
SECONDS = 10.0
PINGS = 200
PING_BYTES = 250
"""As many as a command has."""
READ = (
    topics.JOINT_POSITIONS,
    topics.CLOCK,
    topics.TARGET,
    topics.JOINTS_ACCEPTED,
    topics.STOP_STATE,
    topics.DESCRIPTION,
)
SAID = (topics.JOINT_COMMAND, topics.JOINTS_ESTIMATED, topics.CONTROL_STATUS)
SERVED = (topics.MODE, topics.FORWARD_KINEMATICS, topics.SOLVE_IK)
HEALTH_BYTES = 400
HEALTH_S = 1.0
_SPAWN = multiprocessing.get_context("spawn")


def _hold(endpoint: str, robots: Sequence[str], done: Event) -> None:
    """Holds a session for each robot, until told."""
    sessions, healths = [], []
    for robot in robots:
        session = session_of(endpoint, robot)
        key = topics.HEALTH.key_for("control")
        kept = [session.declare_subscriber(topic.key, zenoh.handlers.RingChannel(1)) for topic in READ]
        said = [session.declare_publisher(topic.key) for topic in SAID]
        served = [session.declare_queryable(service.key, zenoh.handlers.RingChannel(1)) for service in SERVED]
        healths.append(session.declare_publisher(key))
        sessions.append((session, kept, said, served, session.liveliness().declare_token(key)))
    while not done.wait(HEALTH_S):
        for health in healths:
            health.put(bytes(HEALTH_BYTES))
    for session, *_ in sessions:
        session.close()  # type: ignore[no-untyped-call]


@contextmanager
def held(endpoint: str, count: int) -> Iterator[None]:
    """So many sessions."""
    done = _SPAWN.Event()
    robots = [f"robots/{index}" for index in range(count)]
    holders = [
        _SPAWN.Process(target=_hold, args=(endpoint, robots[first::HOLDERS], done), daemon=True)
        for first in range(HOLDERS)
    ]
    for holder in holders:
        holder.start()
    try:
        yield
    finally:
        done.set()
        for holder in holders:
            holder.join(30)


class Watcher:
    """Sees who is there, and sends a message to itself through the router."""

    def __init__(self, endpoint: str, closing: ExitStack) -> None:
        """Two sessions of its own."""
        self._session, other = (closing.enter_context(session_of(endpoint, "")) for _ in range(2))
        self._there: set[str] = set()
        self._took_ms: list[float] = []
        self._tokens = self._session.liveliness().declare_subscriber(
            f"robots/*/{topics.HEALTH.key_for('control')}", self._changed, history=True
        )
        self._ping = self._session.declare_publisher("bench/ping", priority=zenoh.Priority.REAL_TIME, express=True)
        pong = other.declare_publisher("bench/pong", priority=zenoh.Priority.REAL_TIME, express=True)
        self._kept = [
            other.declare_subscriber("bench/ping", lambda sample: pong.put(sample.payload)),
            self._session.declare_subscriber("bench/pong", self._came_back),
        ]

    def count(self) -> int:
        """Tokens that are there."""
        return len(self._there)

    def ping_ms(self) -> list[float]:
        """There and back, a hundred times a second."""
        self._took_ms.clear()
        for _ in range(PINGS):
            self._sent = time.monotonic()
            self._ping.put(bytes(PING_BYTES))
            time.sleep(0.01)
        time.sleep(0.2)
        return list(self._took_ms)

    def _changed(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        if sample.kind == zenoh.SampleKind.PUT:
            self._there.add(key)
        else:
            self._there.discard(key)

    def _came_back(self, _: zenoh.Sample) -> None:
        self._took_ms.append((time.monotonic() - self._sent) * 1e3)


def measure(count: int) -> list[Result]:
    """One router with so many sessions, and again after it was killed."""
    rows: list[Result] = []

    def row(figure: str, value: float, unit: str) -> None:
        rows.append(Result(f"{count} sessions: {figure}", value, unit, "", None, "", None))

    with Stack() as stack, ExitStack() as closing:
        stack.start("router")
        time.sleep(1.0)
        watcher = Watcher(stack.endpoint, closing)
        process = stack.process("router")
        assert process is not None
        began = time.monotonic()
        with held(stack.endpoint, count):
            until(lambda: watcher.count() == count, f"{count} sessions are there")
            row("all there after", time.monotonic() - began, "s")
            time.sleep(2.0)
            used_s, began = processor_s([process.pid]), time.monotonic()
            took_ms = watcher.ping_ms()
            time.sleep(max(0.0, SECONDS - (time.monotonic() - began)))
            row("router", 100 * (processor_s([process.pid]) - used_s) / (time.monotonic() - began), "% of a core")
            row("router's memory, PSS", memory(process.pid).pss_mb, "MB")
            row("a message there and back, p50", statistics.median(took_ms), "ms")
            row("a message there and back, p99", percentile(took_ms, 99), "ms")
            stack.kill("router", signal.SIGKILL)
            until(lambda: watcher.count() == 0, "nobody is there")
            began = time.monotonic()
            stack.start("router")
            until(lambda: watcher.count() == count, f"{count} sessions are there again")
            row("all there again after the router was killed and started", time.monotonic() - began, "s")
    return rows


if __name__ == "__main__":
    publish("sessions", [row for count in COUNTS for row in measure(count)])
