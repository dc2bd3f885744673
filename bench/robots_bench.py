"""How vision grows with the number of robots; writes results/robots.json.

Frames of a snapshot are sent under the names of 1, 2, 4, … robots, over TCP and with shared memory, to one vision for
each robot and to one for all: what that takes of the processors, how long answers take, and from where on it stops
keeping up. Sender, router and all that is measured share this machine's processors.
"""

import os
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from filmed import filmed, snapshot
from processes import processor_s
from running import bus_of

from armsight import topics
from armsight.bus import Received
from armsight.times import wall_ns
from armsight.v1.joints_pb2 import JointCommand, JointPositions, StageTimes
from armsight_operator.picture import Snapshot
from armsight_operator.stack import Stack
from results import Result, compare, percentile, publish

ROBOTS = (1, 2, 4, 8, 16)
WITH_CONTROL = (1, 2, 4)
CONTROL = {"control": ["--solver", "closed-form"]}
"""Nothing is left to be loaded when it answers first."""
RATES_HZ = (30.0, 10.0)
SECONDS = 5.0
IDLE_SECONDS = 5.0
READY_S = 20.0
KEPT_UP = 0.95
"""Share of the instants that are sent, and answered, by whoever keeps up; where not, no more robots are tried."""
IN_TIME_MS = 100.0
"""As long as a command is valid."""


@dataclass(frozen=True, slots=True)
class Load:
    """What is measured at once."""

    robots: int
    rate_hz: float
    shared_memory: bool
    one_vision: bool
    control: bool = False

    @property
    def series(self) -> str:
        """All but the number of robots, for a person."""
        memory = "shared memory" if self.shared_memory else "TCP"
        vision = "one vision for all" if self.one_vision else "a vision for each"
        return f"{self.rate_hz:g} Hz, {memory}, {vision}{', control' if self.control else ''}"

    @property
    def names(self) -> list[str]:
        """The robots'."""
        return [f"bench/{index}" for index in range(self.robots)]


@dataclass(frozen=True, slots=True)
class Measured:
    """What came of it; processors' shares are of one core, of all robots together."""

    cores: dict[str, float]
    """By who uses them."""
    sent: float
    """Share of the instants that were to be sent: less than all where the senders are too slow for this machine."""
    answered: float
    """Share of those that were sent."""
    latency_ms: tuple[float, float]
    """p50 and p99 from frames published to positions received here, or commands with control."""

    @property
    def keeps_up(self) -> bool:
        """Whether nearly all is answered in time."""
        return min(self.sent, self.answered) >= KEPT_UP and self.latency_ms[1] <= IN_TIME_MS


class Listener:
    """Takes what is answered to each robot while it is told to."""

    def __init__(self) -> None:
        """Keeps nothing yet."""
        self.heard: set[str] = set()
        self.latencies_ms: list[float] = []
        self._counts = False
        self._lock = threading.Lock()

    def begin(self) -> None:
        """Keeps from now on."""
        with self._lock:
            self._counts = True

    def end(self) -> None:
        """Keeps no more."""
        with self._lock:
            self._counts = False

    def take(self, robot: str, stages: StageTimes) -> None:
        """One answer."""
        now_ns = wall_ns()
        with self._lock:
            self.heard.add(robot)
            if self._counts:
                self.latencies_ms.append((now_ns - stages.frames_sent_ns) / 1e6)


def is_whole(positions: JointPositions) -> bool:
    """Whether any marker was seen by more than one camera: of an instant whose frames were both there."""
    return any(len(marker.observations) > 1 for marker in positions.markers)


@contextmanager
def served(load: Load) -> Iterator[tuple[str, dict[str, list[int]]]]:
    """A router and the processes of all robots.

    Yields:
        The router's endpoint, and process ids by what they are.
    """
    os.environ["ARMSIGHT_SHARED_MEMORY"] = "" if load.shared_memory else "off"
    first, *others = load.names
    with ExitStack() as closing:
        flags = [flag for name in others for flag in ("--namespace", name)] if load.one_vision else []
        stack = closing.enter_context(Stack(namespace=first, mode="hold", extra={"vision": flags, **CONTROL}))
        stacks = [stack]
        stacks += [
            closing.enter_context(Stack(namespace=each, mode="hold", port=stack.port, extra=CONTROL)) for each in others
        ]
        stack.start("router")
        for each in stacks[:1] if load.one_vision else stacks:
            each.start("vision")
        if load.control:
            for each in stacks:
                each.start("control")
        pids = {
            name: [process.pid for each in stacks if (process := each.process(name)) is not None]
            for name in ("router", "vision", "control")
        }
        yield stack.endpoint, {name: found for name, found in pids.items() if found}


def measure(load: Load, taken: Snapshot) -> Measured:
    """Sends frames for a while."""
    listener = Listener()
    with served(load) as (endpoint, pids), ExitStack() as closing:
        for name in load.names:
            bus = closing.enter_context(bus_of(endpoint, name))

            def positions(received: Received[JointPositions], robot: str = name) -> None:
                if is_whole(received.message):
                    listener.take(robot, received.message.stages)

            def command(received: Received[JointCommand], robot: str = name) -> None:
                listener.take(robot, received.message.stages)

            if load.control:
                bus.subscriber(topics.JOINT_COMMAND, keep=64, on_message=command)
            else:
                bus.subscriber(topics.JOINT_POSITIONS, keep=64, on_message=positions)
        senders = closing.enter_context(filmed(endpoint, load.names, taken, load.rate_hz, load.shared_memory))
        deadline = time.monotonic() + READY_S
        while len(listener.heard) < load.robots and time.monotonic() < deadline:
            time.sleep(0.1)
        time.sleep(1.0)

        def used_s() -> dict[str, float]:
            used = {name: processor_s(found) for name, found in pids.items()}
            return used | {"senders": processor_s(senders.pids)}

        before, began, sent_before = used_s(), time.monotonic(), senders.sent()
        listener.begin()
        time.sleep(SECONDS)
        listener.end()
        took_s, sent = time.monotonic() - began, senders.sent() - sent_before
        cores = {name: (used - before[name]) / took_s for name, used in used_s().items()}
    latencies = listener.latencies_ms or [float("inf")]
    return Measured(
        cores,
        sent / (took_s * load.rate_hz * load.robots),
        len(listener.latencies_ms) / max(1, sent),
        (percentile(latencies, 50), percentile(latencies, 99)),
    )


def results_of(load: Load, measured: Measured, alone: Measured) -> list[Result]:
    """Rows of one load: what all robots take beside what the first took, times their number."""
    title = f"{load.series}, {load.robots} robots"
    line = f"{load.robots} x 1 robot"
    rows = [
        compare(f"{title}: {name}", 100 * cores, "% of a core", line, 100 * load.robots * alone.cores[name])
        for name, cores in measured.cores.items()
        if alone.cores[name] > 0
    ]
    rows.append(Result(f"{title}: sent", 100 * measured.sent, "%", "", None, "", None))
    rows.append(Result(f"{title}: answered", 100 * measured.answered, "%", "", None, "", None))
    for percent, ms, before in zip((50, 99), measured.latency_ms, alone.latency_ms, strict=True):
        rows.append(compare(f"{title}: answered after, p{percent}", ms, "ms", "1 robot", before))
    return rows


def measure_series(counts: Sequence[int], taken: Snapshot, **options: object) -> list[Result]:
    """More and more robots, until it stops keeping up."""
    rows: list[Result] = []
    alone = None
    most = 0
    for robots in counts:
        load = Load(robots=robots, **options)  # type: ignore[arg-type]
        measured = measure(load, taken)
        alone = alone or measured
        rows += results_of(load, measured, alone)
        print(f"{load.series}, {robots} robots: {measured}", flush=True)
        if not measured.keeps_up:
            break
        most = robots
    rows.append(Result(f"{load.series}: most robots that it keeps up with", most, "robots", "", None, "", None))
    return rows


def measure_idle() -> list[Result]:
    """What a vision takes of whose robots none sends anything."""
    rows = []
    for robots in (1, 16):
        idle = Load(robots, rate_hz=30.0, shared_memory=False, one_vision=True)
        with served(idle) as (endpoint, pids), bus_of(endpoint, idle.names[-1]) as bus:
            if bus.subscriber(topics.HEALTH, "vision").recv(READY_S) is None:
                raise RuntimeError("vision says nothing of itself")
            time.sleep(1.0)
            before = processor_s(pids["vision"])
            time.sleep(IDLE_SECONDS)
            used = (processor_s(pids["vision"]) - before) / IDLE_SECONDS
        rows.append(
            Result(f"vision of {robots} robots that send nothing", 100 * used, "% of a core", "", None, "", None)
        )
    return rows


def main() -> None:
    """Everything, in some eight minutes."""
    taken = snapshot()
    rows = measure_idle()
    for rate_hz in RATES_HZ:
        for shared_memory in (False, True):
            for one_vision in (False, True):
                rows += measure_series(
                    ROBOTS, taken, rate_hz=rate_hz, shared_memory=shared_memory, one_vision=one_vision
                )
        rows += measure_series(WITH_CONTROL, taken, rate_hz=rate_hz, shared_memory=True, one_vision=True, control=True)
    load = os.getloadavg()[0]
    rows.append(Result("load of this machine at the end, a minute's", load, "", "", None, "", None))
    publish("robots", rows)


if __name__ == "__main__":
    main()
