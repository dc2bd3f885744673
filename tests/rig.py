"""What the integration tests do with a stack: start and kill its processes, ask it, watch the truth."""

import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Point3InFrame_pb2 import Point3InFrame
from google.protobuf.message import Message

from armsight import topics
from armsight.bus import Bus, Received, Subscriber
from armsight.session import SessionConfig, open_session
from armsight.times import NS_PER_S, from_timestamp, to_duration, to_timestamp
from armsight.v1.control_pb2 import ControlState, ControlStatus, SetModeRequest
from armsight.v1.health_pb2 import HEALTH_STATUS_OK, Health
from armsight.v1.joints_pb2 import JointCommand, JointSetpoint
from armsight.v1.safety_pb2 import STOP_ACTION_RELEASE, STOP_ACTION_STOP, StopRequest
from armsight.v1.sim_pb2 import ResetRequest
from armsight_operator.stack import Stack, Supervisor

Vector = npt.NDArray[np.float64]
JOINTS = ("joint1", "joint2", "joint3", "joint4")
SERVICES = ("sim", "vision", "control")

_RECORDED = (topics.JOINT_POSITIONS, topics.JOINT_COMMAND, topics.JOINTS_TRUE)

# Faster than a controller at rest lets any joint creep, slower than any motion that the tests ask for.
MOVING_RAD_S = 0.01


class Truth:
    """The true joint angles over a while, against sim's own clock."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.angles: list[list[float]] = []

    def add(self, received: Received[JointStates]) -> None:
        self.times.append(from_timestamp(received.message.timestamp) / NS_PER_S)
        self.angles.append([joint.position for joint in received.message.joints])

    def joint(self, index: int) -> Vector:
        return np.array(self.angles)[:, index]

    def assert_speed_below(self, limit_rad_s: float) -> None:
        assert len(self.times) > 10, "too few true angles were recorded"
        times, angles = np.array(self.times), np.array(self.angles)
        new = np.diff(times) > 1e-6
        speed = np.abs(np.diff(angles, axis=0)[new]) / np.diff(times)[new, None]
        # a twentieth above the limit: the position actuator may overshoot the setpoint's own speed that much
        assert speed.max() <= 1.05 * limit_rad_s, f"a joint moved at {speed.max():.2f} rad/s"


class Rig:
    """One stack on a private port, and a place on its bus.

    Args:
        stack: the processes.
        endpoint: of the router, for the test and whoever watches (default: that of the services).
    """

    def __init__(self, stack: Stack, endpoint: str | None = None) -> None:
        self.stack = stack
        self.endpoint = endpoint or stack.endpoint
        self._bus: Bus | None = None
        self._truth: Subscriber[JointStates] | None = None
        self._status: Subscriber[ControlStatus] | None = None
        self._health: dict[str, Received[Health]] = {}

    # processes

    def start(self, name: str) -> None:
        self.stack.start(name)

    def start_all(self) -> None:
        for name in ("router", *SERVICES):
            self.start(name)

    def kill(self, name: str) -> None:
        self.stack.kill(name, signal.SIGKILL)
        self._health.pop(name, None)

    def seconds_to_stop(self, name: str) -> float:
        started = time.monotonic()
        self.stack.kill(name, signal.SIGTERM)
        return time.monotonic() - started

    @contextmanager
    def supervised(self) -> Iterator[None]:
        """Who dies by itself is started again, as `armsight up` and Docker Compose do; it is printed."""
        supervisor = Supervisor(self.stack)

        def watch() -> None:
            for death in supervisor.poll():
                print(death)

        with again_and_again(watch):
            yield

    def close(self) -> None:
        if self._bus is not None:
            self._bus.session.close()  # type: ignore[no-untyped-call]
        self.stack.close()

    # waiting

    def pause(self, seconds: float) -> None:
        """Lets the system run: for what must NOT happen in a while."""
        time.sleep(seconds)

    def wait_until(self, condition: Callable[[], bool], timeout_s: float, what: str) -> None:
        deadline = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > deadline:
                raise AssertionError(f"not within {timeout_s:g} s: {what}\n{self.describe()}")
            time.sleep(0.02)

    def wait_ready(self, timeout_s: float = 40.0) -> None:
        _ = self.bus
        asked = time.monotonic()

        def ready() -> bool:
            fresh = [self._health.get(name) for name in SERVICES]
            return all(
                health is not None and health.received_s > asked and health.message.status == HEALTH_STATUS_OK
                for health in fresh
            )

        self.wait_until(ready, timeout_s, "sim, vision and control report themselves well")

    def describe(self) -> str:
        lines = [f"{name}: {h.message.status} {h.message.detail}" for name, h in sorted(self._health.items())]
        status = self._status.latest if self._status is not None else None
        if status is not None:
            lines.append(f"control: {status.message}")
        return "\n".join([*lines, f"logs in {self.stack.log_folder}"])

    # the bus

    @property
    def bus(self) -> Bus:
        if self._bus is None:
            config = SessionConfig(
                endpoints=(self.endpoint,), shared_memory="off", file=self.stack.zenoh_config("operator")
            )
            session = open_session(config, threading.Event())
            assert session is not None
            self._bus = Bus(session)
            self._truth = self._bus.subscriber(topics.JOINTS_TRUE)
            self._status = self._bus.subscriber(topics.CONTROL_STATUS)

            def keep(received: Received[Health]) -> None:
                self._health[received.name] = received

            self._bus.subscriber(topics.HEALTH, "*", on_message=keep)
        return self._bus

    def heard_of(self, service: str) -> bool:
        return service in self._health

    def health(self, service: str) -> Health:
        return self._health[service].message

    def counters(self, service: str) -> dict[str, int]:
        return dict(self._health[service].message.counters)

    def instances(self) -> dict[str, str]:
        return {name: self._health[name].message.instance for name in SERVICES}

    # asking

    def mode(self, name: str, joints: Sequence[float] = (), start_s: float = 0.0) -> None:
        request = SetModeRequest(
            mode=f"CONTROL_MODE_{name.upper().replace('-', '_')}",
            joints=[JointSetpoint(name=j, position_rad=q) for j, q in zip(JOINTS, joints, strict=False)],
            start_s=start_s,
        )
        self.bus.query(topics.MODE, request)

    def reset(self, joints: Iterable[float]) -> int:
        request = ResetRequest(
            joints=[JointSetpoint(name=j, position_rad=q) for j, q in zip(JOINTS, joints, strict=True)]
        )
        return from_timestamp(self.bus.query(topics.RESET, request).capture_time)

    def stop_arm(self, source: str) -> None:
        self.bus.query(topics.STOP, StopRequest(action=STOP_ACTION_STOP, source=source, reason="test"))

    def release_arm(self, source: str) -> None:
        self.bus.query(topics.RELEASE, StopRequest(action=STOP_ACTION_RELEASE, source=source))

    def put_command(self, positions: dict[str, float], age_s: float = 0.0) -> None:
        truth = self._next_truth()
        command = JointCommand(
            answers=to_timestamp(from_timestamp(truth.timestamp) - round(age_s * NS_PER_S)),
            valid_for=to_duration(0.1),
            joints=[JointSetpoint(name=name, position_rad=q) for name, q in positions.items()],
        )
        self.bus.publisher(topics.JOINT_COMMAND).put(command)

    @contextmanager
    def publishing_target(self, target: Sequence[float]) -> Iterator[None]:
        publisher = self.bus.publisher(topics.TARGET)
        message = Point3InFrame(frame_id="base")
        message.point.x, message.point.y, message.point.z = target
        with again_and_again(lambda: publisher.put(message)):
            yield

    # watching

    def true_joints(self) -> Vector:
        return np.array([joint.position for joint in self._latest_truth().joints])

    def tip_error(self, target: Sequence[float]) -> float:
        return float(np.linalg.norm(tip_with_joint_2_fixed(self.true_joints()) - np.array(target)))

    def moving(self) -> bool:
        """Whether the arm moves by sim's own account; without sim nothing does."""
        _ = self.bus
        assert self._truth is not None
        latest = self._truth.latest
        if latest is None or time.monotonic() - latest.received_s > 0.5:
            return False
        return max(abs(joint.velocity) for joint in latest.message.joints) > MOVING_RAD_S

    def moved_since(self, wall_ns: int) -> bool:
        """Whether the arm moves, and that was heard after a time of the wall clock."""
        assert self._truth is not None
        latest = self._truth.latest
        age_s = (time.time_ns() - wall_ns) / NS_PER_S
        return latest is not None and time.monotonic() - latest.received_s < age_s and self.moving()

    def control_state(self) -> str:
        _ = self.bus
        assert self._status is not None
        latest = self._status.latest
        if latest is None or time.monotonic() - latest.received_s > 1.0:
            return "SILENT"
        return ControlState.Name(latest.message.state).removeprefix("CONTROL_STATE_")

    @contextmanager
    def recording_truth(self) -> Iterator[Truth]:
        truth = Truth()
        subscriber = self.bus.subscriber(topics.JOINTS_TRUE, keep=1000, on_message=truth.add)
        try:
            yield truth
        finally:
            subscriber.close()

    def answered_share(self, seconds: float) -> tuple[float, float]:
        """Frames a second by sim's captures, and the share of them that a command answers."""
        captured: set[int] = set()
        answered: set[int] = set()
        frames = self.bus.subscriber(
            topics.JOINTS_TRUE,
            keep=1000,
            on_message=lambda r: captured.add(from_timestamp(r.message.timestamp)),
        )
        commands = self.bus.subscriber(
            topics.JOINT_COMMAND, keep=1000, on_message=lambda r: answered.add(from_timestamp(r.message.answers))
        )
        time.sleep(seconds)
        frames.close()
        time.sleep(0.2)
        commands.close()
        return len(captured) / seconds, len(captured & answered) / len(captured)

    def record_from_the_start(self, instants: int) -> dict[str, list[bytes]]:
        """Starts everything, sim last; the first messages by key, by instant, without wall-clock times."""
        for name in ("router", "vision", "control"):
            self.start(name)
        kept: dict[str, dict[int, bytes]] = {topic.key: {} for topic in _RECORDED}

        def keep(received: Received[Any]) -> None:
            stamp, content = without_stages(received.message)
            kept[received.key.removeprefix(f"{self.stack.namespace}/")].setdefault(stamp, content)

        for topic in _RECORDED:
            self.bus.subscriber(topic, keep=1000, on_message=keep)
        self.wait_until(lambda: {"vision", "control"} <= set(self._health), 20, "vision and control are there")
        self.start("sim")
        self.wait_until(lambda: all(len(seen) > instants for seen in kept.values()), 60, f"{instants} instants")
        return {key: [seen[stamp] for stamp in sorted(seen)[:instants]] for key, seen in kept.items()}

    def _next_truth(self) -> JointStates:
        """Of an instant that nobody has answered yet."""
        before = from_timestamp(self._latest_truth().timestamp)
        self.wait_until(lambda: from_timestamp(self._latest_truth().timestamp) > before, 5, "the next instant")
        return self._latest_truth()

    def _latest_truth(self) -> JointStates:
        _ = self.bus
        assert self._truth is not None
        self.wait_until(lambda: self._truth is not None and self._truth.latest is not None, 10, "sim tells the truth")
        latest = self._truth.latest
        assert latest is not None
        return latest.message


@contextmanager
def again_and_again(do: Callable[[], None], every_s: float = 0.1) -> Iterator[None]:
    """Something is done every so often meanwhile, beside the test."""
    done = threading.Event()

    def repeat() -> None:
        while not done.wait(every_s):
            do()

    thread = threading.Thread(target=repeat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


@contextmanager
def started(stack: Stack) -> Iterator[Rig]:
    """A rig on a stack all of whose processes run and are well, and of which nothing is left afterwards."""
    rig = Rig(stack)
    try:
        rig.start_all()
        rig.wait_ready()
        yield rig
    finally:
        rig.close()


def without_stages(message: Message) -> tuple[int, bytes]:
    """A message's instant, and its bytes without the wall-clock times of its stages, which no two runs share."""
    copy = type(message)()
    copy.CopyFrom(message)
    if "stages" in message.DESCRIPTOR.fields_by_name:
        copy.ClearField("stages")
    field = next(name for name in ("capture_time", "answers", "timestamp") if name in message.DESCRIPTOR.fields_by_name)
    return from_timestamp(getattr(message, field)), copy.SerializeToString(deterministic=True)


def tip_with_joint_2_fixed(q: Vector) -> Vector:
    """The report's K(q), base frame, metres (arm.md's closed form, for joint 2 = 0 only)."""
    theta, _, phi, psi = q
    sin_theta, cos_theta = np.sin(theta), np.cos(theta)
    reach = np.sin(phi) * (2.8 * np.cos(psi) + 3.2)
    side = 2.8 * np.sin(psi)
    up = np.cos(phi) * (2.8 * np.cos(psi) + 3.2) + 4.0
    return np.array([cos_theta * side + sin_theta * reach, sin_theta * side - cos_theta * reach, up])
