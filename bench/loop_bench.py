"""The whole loop beside a plain Zenoh echo of the same bytes; writes results/loop.json.

For TCP and for shared memory, on one router in turn: the stack in real time for a while, then the echo. Last, lockstep
beside rendering alone.
"""

import contextlib
import os
import threading
import time
from collections.abc import Iterator

from armsight import topics
from armsight.bus import Bus, Received, open_bus
from armsight.session import SessionConfig, open_session
from armsight.times import from_timestamp
from armsight.v1.control_pb2 import ControlStatus
from armsight_operator.monitor import Monitor
from armsight_operator.report.run import wait_ready
from armsight_operator.stack import SERVICES, Stack
from armsight_sim.gl import choose_gl
from echo import measure as measure_echo
from results import Result, at_least, at_most, compare, percentile, publish

ROUNDS = 2
SECONDS = 10.0
PAIRS = 200
RATE_HZ = 30.0
LOCKSTEP_SECONDS = 8.0
RENDERS = 100


@contextlib.contextmanager
def bus_of(stack: Stack) -> Iterator[Bus]:
    """A place on a stack's bus."""
    session = open_session(SessionConfig(endpoints=(stack.endpoint,), shared_memory="off"), threading.Event())
    assert session is not None
    with open_bus(session) as bus:
        yield bus


def run_stack(stack: Stack, seconds: float) -> tuple[list[float], float, float]:
    """Latencies from frames sent to command sent (ms), answers a second, and seconds until ready."""
    began = time.monotonic()
    with bus_of(stack) as bus:
        for name in SERVICES:
            stack.start(name)
        wait_ready(Monitor(bus))
        ready_s = time.monotonic() - began
        bus.query(topics.MODE, topics.MODE.request(mode="CONTROL_MODE_TEST_2"))
        time.sleep(1.0)
        latencies: dict[int, float] = {}

        def keep(received: Received[ControlStatus]) -> None:
            stages = received.message.stages
            stamp = from_timestamp(received.message.capture_time)
            latencies[stamp] = (stages.control_sent_ns - stages.frames_sent_ns) / 1e6

        subscriber = bus.subscriber(topics.CONTROL_STATUS, keep=256, on_message=keep)
        time.sleep(seconds)
        subscriber.close()
    stack.stop()
    return list(latencies.values()), len(latencies) / seconds, ready_s


def measure_latency(shared_memory: bool) -> list[Result]:
    """The loop's latency beside the echo's, in turn on one router."""
    os.environ["ARMSIGHT_SHARED_MEMORY"] = "" if shared_memory else "off"
    name = "shared memory" if shared_memory else "TCP"
    loop: list[float] = []
    echo: list[float] = []
    rates: list[float] = []
    readies: list[float] = []
    with Stack(target="none", mode="hold") as stack:
        stack.start("router")
        time.sleep(1.0)
        for _ in range(ROUNDS):
            latencies, rate, ready_s = run_stack(stack, SECONDS)
            loop += latencies
            rates.append(rate)
            readies.append(ready_s)
            echo += measure_echo(stack.endpoint, PAIRS, RATE_HZ, shared_memory)
    results = [
        compare(f"{name}: frames to command, p{p}", percentile(loop, p), "ms", f"echo p{p}", percentile(echo, p))
        for p in (50, 99)
    ]
    if shared_memory:
        results.append(at_least("answers a second in real time", min(rates), "Hz", 0.95 * RATE_HZ))
        results.append(at_most("services ready after", max(readies), "s", 10.0))
    return results


def measure_lockstep() -> list[Result]:
    """Instants a second in lockstep beside rendering alone."""
    os.environ["ARMSIGHT_SHARED_MEMORY"] = ""
    results = []
    for samples in (0, 4):
        with Stack(clock="lockstep", samples=samples, target="none", mode="hold") as stack:
            stack.start("router")
            _, rate, _ = run_stack(stack, LOCKSTEP_SECONDS)
        alone = renders_a_second(samples)
        results.append(compare(f"lockstep, {samples} samples a pixel", rate, "Hz", "rendering alone", alone))
    return results


def renders_a_second(samples: int) -> float:
    """Pairs of frames that MuJoCo alone draws."""
    choose_gl()
    from armsight_sim.cameras import Cameras
    from armsight_sim.world import World, load_model

    world = World(load_model(), 1 / RATE_HZ)
    cameras = Cameras(world.model, ["1", "2"], 800, 800, samples)
    for _ in range(10):
        cameras.draw(world.data)
    began = time.monotonic()
    for _ in range(RENDERS):
        cameras.draw(world.data)
    rate = RENDERS / (time.monotonic() - began)
    cameras.close()
    return rate


if __name__ == "__main__":
    publish("loop", [*measure_latency(False), *measure_latency(True), *measure_lockstep()])
