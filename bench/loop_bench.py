"""The whole loop beside a plain Zenoh echo of the same bytes; writes results/loop.json.

For TCP and for shared memory, on one router in turn: the stack in real time for a while, then the echo. Last, lockstep
beside rendering alone.
"""

import contextlib
import os
import signal
import statistics
import time

from running import bus_of, until

from armsight import topics
from armsight.bus import Received
from armsight.frame_pool import FramePool
from armsight.images import encode_rgb8
from armsight.shared_memory import Use
from armsight.times import from_timestamp, to_timestamp
from armsight.topics import SERVICES
from armsight.v1.control_pb2 import CONTROL_STATE_MOVING, ControlStatus
from armsight.v1.joints_pb2 import JointCommand, JointPositions, StageTimes
from armsight.v1.sim_pb2 import CLOCK_MODE_REALTIME, Clock
from armsight_operator.monitor import Monitor
from armsight_operator.picture import take_snapshot
from armsight_operator.report.run import wait_ready
from armsight_operator.stack import Stack
from armsight_sim.gl import choose_gl
from echo import measure as measure_echo
from results import Result, at_least, at_most, compare, percentile, publish

ROUNDS = 2
SECONDS = 10.0
PAIRS = 200
RATE_HZ = 30.0
LOCKSTEP_SECONDS, LOCKSTEP_ROUNDS = 8.0, 3
RENDERS = 100
REPLAYED = 600
WARM_UP = 60
CONTROL_MODES = (
    ("test-1", "lockstep", "none"),
    ("test-2", "lockstep", "none"),
    ("test-all", "lockstep", "none"),
    ("track", "realtime", "default"),
    ("follow", "realtime", "visible"),
)
CONTROL_SECONDS = 20.0


def watch(stack: Stack, seconds: float) -> tuple[dict[int, StageTimes], float]:
    """Starts the services beside a router that runs, and stops them; in between listens to what control answers.

    Returns:
        When each stage of an answer was, by capture time; and the seconds until the services were ready.
    """
    began = time.monotonic()
    stages: dict[int, StageTimes] = {}

    def keep(received: Received[ControlStatus]) -> None:
        stages[from_timestamp(received.message.capture_time)] = received.message.stages

    with bus_of(stack.endpoint, stack.namespace) as bus:
        for name in SERVICES:
            stack.start(name)
        wait_ready(Monitor(bus))
        ready_s = time.monotonic() - began
        time.sleep(1.0)
        subscriber = bus.subscriber(topics.CONTROL_STATUS, keep=256, on_message=keep)
        time.sleep(seconds)
        subscriber.close()
    stack.stop()
    return stages, ready_s


def measure_latency(shared_memory: bool) -> list[Result]:
    """The loop's latency beside the echo's, in turn on one router."""
    os.environ["ARMSIGHT_SHARED_MEMORY"] = "" if shared_memory else "off"
    name = "shared memory" if shared_memory else "TCP"
    loop: list[float] = []
    echo: list[float] = []
    rates: list[float] = []
    readies: list[float] = []
    with Stack(target="none", mode="test-2") as stack:
        stack.start("router")
        time.sleep(1.0)
        for _ in range(ROUNDS):
            stages, ready_s = watch(stack, SECONDS)
            loop += [(each.control_sent_ns - each.frames_sent_ns) / 1e6 for each in stages.values()]
            rates.append(len(stages) / SECONDS)
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


class Sender:
    """Puts recorded frames in the place of sim, as often as it did, and takes the time until each is answered."""

    def __init__(self, stack: Stack, shared_memory: bool, closing: contextlib.ExitStack) -> None:
        """Ends sim once the arm moves, and has what it said last."""
        bus = closing.enter_context(bus_of(stack.endpoint, stack.namespace))
        accepted, target = bus.subscriber(topics.JOINTS_ACCEPTED), bus.subscriber(topics.TARGET)
        status = bus.subscriber(topics.CONTROL_STATUS)
        until(
            lambda: status.latest is not None and status.latest.message.state == CONTROL_STATE_MOVING, "the arm moves"
        )
        self._snapshot = take_snapshot(bus, timeout_s=20.0)
        latest_accepted, latest_target = accepted.latest, target.latest
        if latest_accepted is None or latest_target is None:
            raise RuntimeError("sim says neither setpoint nor target")
        self._target = latest_target.message
        stack.kill("sim", signal.SIGKILL)
        memory: Use = "publish" if shared_memory else "off"
        sending = closing.enter_context(bus_of(stack.endpoint, stack.namespace, memory))
        self._pool = FramePool(memory, sending.counters)
        self._frames = {name: sending.publisher(topics.CAMERA_IMAGE, name) for name in self._snapshot.cameras}
        self._clock, self._targets = sending.publisher(topics.CLOCK), sending.publisher(topics.TARGET)
        sending.publisher(topics.JOINTS_ACCEPTED).put(latest_accepted.message)
        self._sent_ns: dict[int, int] = {}
        self.taken_ms: list[float] = []
        bus.subscriber(topics.JOINT_COMMAND, keep=64, on_message=self._heard)

    def _heard(self, received: Received[JointCommand]) -> None:
        sent_ns = self._sent_ns.pop(from_timestamp(received.message.answers), None)
        if sent_ns is not None:
            self.taken_ms.append((time.monotonic_ns() - sent_ns) / 1e6)

    def send(self, pairs: int) -> None:
        """So many instants, encoded before their time is taken."""
        answered_before = len(self.taken_ms)
        for _ in range(pairs):
            due = time.monotonic() + 1 / RATE_HZ
            capture_ns = time.time_ns()
            # sim says these first, and draws then
            self._clock.put(Clock(capture_time=to_timestamp(capture_ns), mode=CLOCK_MODE_REALTIME))
            self._target.timestamp.CopyFrom(to_timestamp(capture_ns))
            self._targets.put(self._target)
            images = [(name, camera.image) for name, camera in self._snapshot.cameras.items()]
            payloads = {
                name: self._pool.encode_rgb8(i.data, i.width, i.height, i.frame_id, capture_ns) for name, i in images
            }
            self._sent_ns[capture_ns] = time.monotonic_ns()
            for name in list(payloads):
                self._frames[name].put_bytes(payloads.pop(name))
            time.sleep(max(0.0, due - time.monotonic()))
        time.sleep(0.3)
        answered = len(self.taken_ms) - answered_before
        if answered < 0.95 * pairs:
            raise RuntimeError(f"{answered} of {pairs} instants were answered")


def measure_recorded(shared_memory: bool) -> list[Result]:
    """Frames published to command received, without rendering, beside an echo of the same bytes, in turn."""
    os.environ["ARMSIGHT_SHARED_MEMORY"] = "" if shared_memory else "off"
    name = "shared memory" if shared_memory else "TCP"
    echo: list[float] = []
    with Stack() as stack, contextlib.ExitStack() as closing:
        for service in ("router", *SERVICES):
            stack.start(service)
        sender = Sender(stack, shared_memory, closing)
        sender.send(WARM_UP)
        sender.taken_ms.clear()
        for _ in range(ROUNDS):
            sender.send(PAIRS)
            echo += measure_echo(stack.endpoint, PAIRS, RATE_HZ, shared_memory)
    title, results = f"{name}, recorded frames: published to command received", []
    for percent, factor, more_ms in ((50, 1.0, 2.0), (99, 1.5, 4.0)):
        value, reference = percentile(sender.taken_ms, percent), percentile(echo, percent)
        against = f"echo p{percent}"
        results.append(compare(f"{title}, p{percent}", value, "ms", against, reference, most=factor, and_more=more_ms))
        results.append(Result(f"{name}, echo, p{percent}", reference, "ms", "", None, "", None))
    return results


def measure_vision() -> list[Result]:
    """Frames received to positions sent over TCP, with nothing else at work: frames of a snapshot, sent again."""
    os.environ["ARMSIGHT_SHARED_MEMORY"] = "off"
    taken_ms: list[float] = []

    def keep(received: Received[JointPositions]) -> None:
        stages = received.message.stages
        taken_ms.append((stages.vision_sent_ns - stages.vision_received_ns) / 1e6)

    with Stack(target="none", mode="hold") as stack, contextlib.ExitStack() as closing:
        for name in ("router", "sim", "vision"):
            stack.start(name)
        bus = closing.enter_context(bus_of(stack.endpoint, stack.namespace))
        snapshot = take_snapshot(bus, timeout_s=20.0)
        positions = bus.subscriber(topics.JOINT_POSITIONS)
        if positions.recv(20.0) is None:
            raise RuntimeError("vision measures nothing")
        positions.close()
        stack.kill("sim", signal.SIGKILL)
        bus.subscriber(topics.JOINT_POSITIONS, keep=256, on_message=keep)
        publishers = {name: bus.publisher(topics.CAMERA_IMAGE, name) for name in snapshot.cameras}
        for _ in range(REPLAYED):
            due = time.monotonic() + 1 / RATE_HZ
            capture_ns = time.time_ns()
            for name, camera in snapshot.cameras.items():
                image = camera.image
                payload = encode_rgb8(image.data, image.width, image.height, image.frame_id, capture_ns)
                publishers[name].put_bytes(payload)
            time.sleep(max(0.0, due - time.monotonic()))
    if len(taken_ms) < 0.95 * REPLAYED:
        raise RuntimeError(f"vision answered {len(taken_ms)} of {REPLAYED} instants")
    return [
        at_most(f"TCP: frames received to positions sent, vision alone, p{p}", percentile(taken_ms, p), "ms", 2.0)
        for p in (50, 99)
    ]


def measure_control() -> list[Result]:
    """Positions received to command sent, through the whole stack, in each of the modes that move.

    In lockstep, but for those with a solver beside the loop: in lockstep they wait for it, so that runs repeat.
    """
    os.environ["ARMSIGHT_SHARED_MEMORY"] = ""
    results = []
    for mode, clock, target in CONTROL_MODES:
        with Stack(clock=clock, target=target, mode=mode) as stack:
            stack.start("router")
            stages, _ = watch(stack, CONTROL_SECONDS)
        taken_ms = [(each.control_sent_ns - each.control_received_ns) / 1e6 for each in stages.values()]
        title = f"{clock}, {mode}: positions received to command sent"
        results.append(Result(f"{title}, p50", percentile(taken_ms, 50), "ms", "", None, "", None))
        results.append(at_most(f"{title}, p99", percentile(taken_ms, 99), "ms", 3.0))
    return results


def measure_lockstep() -> list[Result]:
    """Instants a second in lockstep beside rendering alone, in turn."""
    os.environ["ARMSIGHT_SHARED_MEMORY"] = ""
    results = []
    for samples in (0, 4):
        rates, alone = [], []
        for _ in range(LOCKSTEP_ROUNDS):
            rates.append(instants_a_second(samples))
            alone.append(renders_a_second(samples))
        title = f"lockstep, {samples} samples a pixel"
        rate, reference = statistics.median(rates), statistics.median(alone)
        results.append(compare(title, rate, "Hz", "rendering alone", reference, least=0.85))
    return results


def instants_a_second(samples: int) -> float:
    """Of the stack in lockstep, by sim's count at the beginning and at the end: who listened would slow it down."""
    with Stack(clock="lockstep", samples=samples, target="none", mode="test-2") as stack:
        for name in ("router", *SERVICES):
            stack.start(name)
        with bus_of(stack.endpoint, stack.namespace) as bus:
            wait_ready(Monitor(bus))
            said = bus.subscriber(topics.HEALTH, "control")
            # torch takes seconds of a core to load
            until(
                lambda: said.latest is not None and "loading" not in said.latest.message.detail, "the solver is there"
            )

        def count() -> tuple[int, float]:
            with bus_of(stack.endpoint, stack.namespace) as bus:
                clock = bus.subscriber(topics.CLOCK).recv(5.0)
                if clock is None:
                    raise RuntimeError("sim does not say its time")
                return clock.message.frame, clock.received_s

        time.sleep(1.0)
        first, began = count()
        time.sleep(LOCKSTEP_SECONDS)
        last, ended = count()
    return (last - first) / (ended - began)


def renders_a_second(samples: int) -> float:
    """Pairs of frames that MuJoCo alone draws."""
    choose_gl()
    from armsight_sim.cameras import Cameras, Commission
    from armsight_sim.world import World, load_model

    world = World(load_model(), 1 / RATE_HZ)
    cameras = Cameras(Commission(world.model, ["1", "2"], 800, 800, samples))
    for _ in range(10):
        cameras.draw(world.data)
    began = time.monotonic()
    for _ in range(RENDERS):
        cameras.draw(world.data)
    rate = RENDERS / (time.monotonic() - began)
    cameras.close()
    return rate


if __name__ == "__main__":
    results = [*measure_vision(), *measure_control()]
    for shared_memory in (False, True):
        results += [*measure_recorded(shared_memory), *measure_latency(shared_memory)]
    publish("loop", [*results, *measure_lockstep()])
