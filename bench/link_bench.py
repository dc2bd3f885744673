"""What crosses the link between two machines with a router each; writes results/link.json. Needs root.

The machines are two network namespaces with one slow cable between them. The robot's has sim and vision, the other one
control and whoever looks. What is counted are bytes on the cable in both directions, by the kernel, headers and all.
"""

import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from running import bus_of, until

from armsight import topics
from armsight.bus import Bus, Received
from armsight.v1.control_pb2 import ControlStatus
from armsight_operator.monitor import Monitor
from armsight_operator.stack import Stack, free_port
from results import Result, percentile, publish

HERE_HOST, ROBOT_HOST = "10.232.1.1", "10.232.1.2"
CABLE, ROBOT = "armbench", "armsight-bench-robot"
MBIT_S = 20.0
QUEUE_MS = 50.0
"""As long as the cable's own queue may get; what comes to a full one is lost."""
LARGE_BUFFER = "#so_sndbuf=131072"
"""Of the robot's end of the link, four times what it has by itself: what the kernel has taken no priority overtakes."""
SETTLE_S = 2.0
SECONDS = 10.0
READY_S = 60.0


def run(*words: str) -> None:
    """A command that must do what it says."""
    subprocess.run(words, check=True, capture_output=True, timeout=10)


@contextmanager
def cable() -> Iterator[None]:
    """A network namespace for the robot, and a slow cable to it."""
    run("ip", "netns", "add", ROBOT)
    try:
        run("ip", "-n", ROBOT, "link", "set", "lo", "up")
        run("ip", "link", "add", CABLE, "type", "veth", "peer", "name", CABLE, "netns", ROBOT)
        run("ip", "addr", "add", f"{HERE_HOST}/24", "dev", CABLE)
        run("ip", "-n", ROBOT, "addr", "add", f"{ROBOT_HOST}/24", "dev", CABLE)
        slow = ("root", "tbf", "rate", f"{MBIT_S:g}mbit", "burst", "64kb", "latency", f"{QUEUE_MS:g}ms")
        for inside in ((), ("-n", ROBOT)):
            run("ip", *inside, "link", "set", CABLE, "up")
            run("tc", *inside, "qdisc", "add", "dev", CABLE, *slow)
        yield
    finally:
        run("ip", "netns", "del", ROBOT)  # and with it the cable


class Elsewhere(Stack):
    """Processes on the robot's machine."""

    def command(self, name: str) -> list[str]:
        """As here, but there."""
        return ["ip", "netns", "exec", ROBOT, *super().command(name)]


def bytes_so_far() -> int:
    """Both directions."""
    folder = Path("/sys/class/net") / CABLE / "statistics"
    return sum(int((folder / name).read_text(encoding="ascii")) for name in ("rx_bytes", "tx_bytes"))


class Loop:
    """The loop as control sees it from its end of the cable."""

    def __init__(self, bus: Bus) -> None:
        """Listens to what control says of every instant."""
        self.latencies_ms: list[float] = []
        bus.subscriber(topics.CONTROL_STATUS, keep=256, on_message=self._take)

    def _take(self, received: Received[ControlStatus]) -> None:
        stages = received.message.stages
        self.latencies_ms.append((stages.control_sent_ns - stages.frames_sent_ns) / 1e6)


def measure(what: str, loop: Loop) -> list[Result]:
    """Bytes a second, and what the loop is like meanwhile, if there is one."""
    time.sleep(SETTLE_S)
    loop.latencies_ms.clear()
    before, began = bytes_so_far(), time.monotonic()
    time.sleep(SECONDS)
    took_s = time.monotonic() - began
    kb_s = (bytes_so_far() - before) / took_s / 1000
    answered = list(loop.latencies_ms)
    rows = [Result(f"{what}: over the link", kb_s, "kB/s", "", None, "", None)]
    if answered:
        rows.append(Result(f"{what}: instants answered", len(answered) / took_s, "Hz", "", None, "", None))
        rows += [
            Result(f"{what}: frames to command, p{p}", percentile(answered, p), "ms", "", None, "", None)
            for p in (50, 99)
        ]
    return rows


@contextmanager
def machines(options: str = "") -> Iterator[tuple[Stack, Stack, Loop]]:
    """Robot and operator, linked; positions cross.

    Args:
        options: of the robot's end of the link, after its endpoint.

    Yields:
        What runs here and what at the robot, both but control, and the loop.
    """
    with ExitStack() as closing:
        link = f"tcp/{HERE_HOST}:{free_port()}"
        here = closing.enter_context(Stack(page_port=0, extra={"router": ["--insecure-bind", "--listen", link]}))
        flags = ["--insecure-bind", "--connect", link + options]
        robot = closing.enter_context(Elsewhere(extra={"router": flags}))
        here.start("router")
        for name in ("router", "sim", "vision"):
            robot.start(name)
        bus = closing.enter_context(bus_of(here.endpoint, here.namespace))
        positions = bus.subscriber(topics.JOINT_POSITIONS)
        if positions.recv(READY_S) is None:
            raise RuntimeError("the robot's positions do not cross the link")
        positions.close()
        yield here, robot, Loop(bus)


def start_control(where: Stack, loop: Loop) -> None:
    """Control at one end, answering."""
    where.start("control")
    until(lambda: len(loop.latencies_ms) > 30, "control answers")


def measure_looking(what: str, here: Stack, loop: Loop) -> list[Result]:
    """The same while somebody here looks at one camera's pictures, as they are."""
    with bus_of(here.endpoint, here.namespace) as eye:
        frames: list[float] = []
        eye.subscriber(topics.CAMERA_IMAGE, "1", on_message=lambda got: frames.append(got.received_s))
        rows = measure(what, loop)
        return [*rows, Result(f"{what}: pictures", len(frames) / (SECONDS + SETTLE_S), "Hz", "", None, "", None)]


def main() -> None:
    """From nobody at the far end to a picture."""
    os.environ["ARMSIGHT_SHARED_MEMORY"] = "off"  # two machines have none in common, two namespaces do
    limits = f"each way, with a queue of {QUEUE_MS:g} ms"
    rows = [Result("the link", MBIT_S, "Mbit/s", limits, None, "", None)]
    with cable():
        with machines() as (here, _, loop):
            rows += measure("nobody at the far end", loop)
            start_control(here, loop)
            rows += measure("control there", loop)
            with bus_of(here.endpoint, here.namespace) as status:
                Monitor(status)
                rows += measure("control and `armsight status` there", loop)
            here.start("page")
            rows += measure("control and the page there", loop)
            here.kill("page")
            rows += measure_looking("control there, and somebody looks at a camera", here, loop)
        with machines() as (here, robot, loop):
            start_control(robot, loop)
            with bus_of(here.endpoint, here.namespace) as status:
                Monitor(status)
                rows += measure("control with the robot, `armsight status` there", loop)
        with machines(LARGE_BUFFER) as (here, _, loop):
            start_control(here, loop)
            rows += measure_looking(f"control there, and somebody looks, with `{LARGE_BUFFER}`", here, loop)
    publish("link", rows)


if __name__ == "__main__":
    main()
