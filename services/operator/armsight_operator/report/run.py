"""A stack in lockstep to measure: poses set at rest, motions watched frame by frame."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import Message

from armsight import topics
from armsight.bus import Bus, Received, Subscriber
from armsight.times import NS_PER_S, from_timestamp
from armsight.v1.control_pb2 import ControlMode, SetModeRequest, SolveIkRequest, SolveIkResponse
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.geometry_pb2 import Vector3
from armsight.v1.joints_pb2 import JointPositions, JointSetpoint
from armsight.v1.sim_pb2 import CLOCK_MODE_LOCKSTEP, ResetRequest
from armsight_operator.errors import NoDataError, OperatorError
from armsight_operator.monitor import Monitor
from armsight_operator.report.chain import Arm, Array, arm_of

M = TypeVar("M", bound=Message)
T = TypeVar("T")

_ANSWER_S = 20.0
_FIFO = 512
"""Samples that wait for the report: seconds of them. What is lost all the same is counted, and an error."""
_READY_S = 60.0


@dataclass(frozen=True, slots=True)
class Instant:
    """One frame pair's answer, and the truth."""

    capture_ns: int
    estimated: Array
    true: Array
    positions: JointPositions
    """What vision measured."""
    latency_ms: float
    """Frames sent to command sent."""


class Run:
    """A place on the bus of a running stack in lockstep."""

    def __init__(self, bus: Bus, monitor: Monitor) -> None:
        """Takes what the bus tells once."""
        self._bus = bus
        self._monitor = monitor
        description: ArmDescription = _first(bus.subscriber(topics.DESCRIPTION), "description")
        self.arm: Arm = arm_of(description)
        self.cameras: tuple[str, ...] = tuple(sorted(description.cameras))
        self.latencies_ms: list[float] = []
        clock = _first(bus.subscriber(topics.CLOCK), "clock")
        if clock.mode != CLOCK_MODE_LOCKSTEP:
            raise OperatorError("the report needs a stack in lockstep: start it with `armsight up --clock lockstep`")
        self._positions = bus.subscriber(topics.JOINT_POSITIONS, keep=_FIFO)

    def calibration(self, camera: str) -> CameraCalibration:
        """Of one camera."""
        return _first(self._bus.subscriber(topics.CAMERA_CALIBRATION, camera), f"calibration of camera {camera}")

    def camera_pose(self, camera: str) -> FrameTransform:
        """T_world_camera of one camera."""
        return _first(self._bus.subscriber(topics.CAMERA_POSE, camera), f"pose of camera {camera}")

    def hold(self) -> None:
        """No motion: poses are set by reset."""
        self._bus.query(topics.MODE, SetModeRequest(mode="CONTROL_MODE_HOLD"), timeout_s=_ANSWER_S)

    def reset(self, q: Array) -> int:
        """Sets a pose at rest; returns the first capture time that shows it."""
        joints = [JointSetpoint(name=name, position_rad=angle) for name, angle in zip(self.arm.names, q, strict=True)]
        return from_timestamp(self._bus.query(topics.RESET, ResetRequest(joints=joints)).capture_time)

    def positions_at(self, capture_ns: int) -> JointPositions:
        """What vision measured at the first instant from a capture time on."""
        return self._next(self._positions, lambda m: from_timestamp(m.capture_time) >= capture_ns)

    def markers_at(self, capture_ns: int) -> dict[str, Array]:
        """Measured marker centres of the first instant from a capture time on, world frame.

        Raises:
            OperatorError: a marker that was never seen.
        """
        return centres(self.positions_at(capture_ns))

    def frames_at(self, capture_ns: int) -> dict[str, Array]:
        """One instant's pictures from a capture time on, by camera: height x width x 3, 0 to 255."""
        kept: dict[int, dict[str, RawImage]] = {}
        lock = threading.Lock()

        def keep(received: Received[RawImage]) -> None:
            with lock:
                stamp = from_timestamp(received.message.timestamp)
                if stamp >= capture_ns:
                    kept.setdefault(stamp, {})[received.name] = received.message

        subscriber = self._bus.subscriber(topics.CAMERA_IMAGE, "*", keep=4, on_message=keep)
        try:
            until = time.monotonic() + _ANSWER_S
            while time.monotonic() < until:
                with lock:
                    whole = [frames for frames in kept.values() if set(frames) >= set(self.cameras)]
                    if whole:
                        return {name: _pixels(whole[0][name]) for name in self.cameras}
                time.sleep(0.01)
        finally:
            subscriber.close()
        raise NoDataError("no frames of both cameras: are they published?")

    def follow(self, mode: str, start_s: float, duration_s: float, progress: Callable[[float], None]) -> list[Instant]:
        """Runs a test motion from a point of its time axis on; every instant of it with the truth."""
        true = self._bus.subscriber(topics.JOINTS_TRUE, keep=_FIFO)
        estimated = self._bus.subscriber(topics.JOINTS_ESTIMATED, keep=_FIFO)
        status = self._bus.subscriber(topics.CONTROL_STATUS, keep=_FIFO)
        measured = self._bus.subscriber(topics.JOINT_POSITIONS, keep=_FIFO)
        truths, estimates, positions = (
            _ByTime(true, _angles),
            _ByTime(estimated, _angles),
            _ByTime(measured, _positions),
        )
        truths.wait()  # the first instant in the new mode may be one whose truth is published already
        request = SetModeRequest(mode=f"CONTROL_MODE_{mode.upper().replace('-', '_')}", start_s=start_s)
        self._bus.query(topics.MODE, request, timeout_s=_ANSWER_S)
        wanted = ControlMode.Value(f"CONTROL_MODE_{mode.upper().replace('-', '_')}")
        try:
            # without a capture time it says that no positions came for a while (a busy machine), and answers none
            first = self._next(status, lambda m: m.mode == wanted and m.HasField("capture_time"))
            begin = from_timestamp(first.capture_time)
            instants: list[Instant] = []
            message = first
            while (stamp := from_timestamp(message.capture_time)) < begin + round(duration_s * NS_PER_S):
                latency = (message.stages.control_sent_ns - message.stages.frames_sent_ns) / 1e6
                instants.append(Instant(stamp, estimates.at(stamp), truths.at(stamp), positions.at(stamp), latency))
                progress((stamp - begin) / NS_PER_S / duration_s)
                message = self._next(status, lambda m, after=stamp: from_timestamp(m.capture_time) > after)  # type: ignore[misc]
            lost = true.lost + estimated.lost + status.lost + measured.lost
        finally:
            for subscriber in (true, estimated, status, measured):
                subscriber.close()
        if lost:
            raise OperatorError(f"{lost} samples were lost: this machine is too busy for the report")
        self.latencies_ms += [instant.latency_ms for instant in instants]
        return instants

    def solve_ik(self, target: Array, start: Array) -> SolveIkResponse:
        """Inverse kinematics of control by the report's descent, from a given start."""
        request = SolveIkRequest(
            solver="gradient-descent",
            target=Vector3(x=target[0], y=target[1], z=target[2]),
            start=[
                JointSetpoint(name=name, position_rad=angle) for name, angle in zip(self.arm.names, start, strict=True)
            ],
        )
        return self._bus.query(topics.SOLVE_IK, request, timeout_s=_ANSWER_S)

    def _next(self, subscriber: Subscriber[M], wanted: Callable[[M], bool]) -> M:
        until = time.monotonic() + _ANSWER_S
        while time.monotonic() < until:
            received = subscriber.recv(until - time.monotonic())
            if received is not None and wanted(received.message):
                return received.message
        snapshot = self._monitor.snapshot()
        said = "; ".join(f"{s.name}: {s.status} {s.detail}".strip() for s in snapshot.services)
        raise NoDataError(f"the loop stands still for {_ANSWER_S:g} s ({said})")


def centres(positions: JointPositions) -> dict[str, Array]:
    """Marker centres by name, world frame.

    Raises:
        OperatorError: a marker that was never seen.
    """
    unseen = [marker.name for marker in positions.markers if not marker.HasField("position")]
    if unseen:
        raise OperatorError(f"vision has never seen {', '.join(unseen)}")
    return {m.name: np.array([m.position.x, m.position.y, m.position.z]) for m in positions.markers}


class _ByTime(Generic[M, T]):
    """What a subscriber gets, by capture time."""

    def __init__(self, subscriber: Subscriber[M], key: Callable[[M], tuple[int, T]]) -> None:
        self._subscriber = subscriber
        self._key = key
        self._kept: dict[int, T] = {}

    def wait(self) -> None:
        """Until the first sample is there: from then on none is missed."""
        self._take(_ANSWER_S)

    def at(self, stamp: int) -> T:
        """That of an instant; those of earlier ones are forgotten."""
        until = time.monotonic() + _ANSWER_S
        while stamp not in self._kept and time.monotonic() < until:
            self._take(until - time.monotonic())
        if stamp not in self._kept:
            raise NoDataError(f"nothing for the instant {stamp}")
        found = self._kept[stamp]
        self._kept = {time_ns: value for time_ns, value in self._kept.items() if time_ns > stamp}
        return found

    def _take(self, timeout_s: float) -> None:
        received = self._subscriber.recv(timeout_s)
        if received is not None:
            stamp, value = self._key(received.message)
            self._kept[stamp] = value


def _angles(states: JointStates) -> tuple[int, Array]:
    return from_timestamp(states.timestamp), np.array([joint.position for joint in states.joints])


def _positions(positions: JointPositions) -> tuple[int, JointPositions]:
    return from_timestamp(positions.capture_time), positions


def wait_ready(monitor: Monitor, timeout_s: float = _READY_S) -> None:
    """Waits until sim, vision and control are well.

    Raises:
        NoDataError: they are not in time; says which and why.
    """
    until = time.monotonic() + timeout_s
    while not monitor.snapshot().ready:
        if time.monotonic() > until:
            raise NoDataError(f"not ready within {timeout_s:g} s: {'; '.join(monitor.snapshot().troubles)}")
        time.sleep(0.05)


@contextmanager
def own_stack(log_folder: Path, samples: int, sim_flags: Sequence[str] = ()) -> Iterator[str]:
    """A stack of our own in lockstep on a private port; yields its endpoint."""
    from armsight_operator.stack import Stack

    extra = {"sim": list(sim_flags)}
    with Stack(clock="lockstep", samples=samples, target="none", mode="hold", out=log_folder, extra=extra) as stack:
        stack.start_all()
        yield stack.endpoint


def _first(subscriber: Subscriber[M], what: str) -> M:
    received = subscriber.recv(_ANSWER_S)
    subscriber.close()
    if received is None:
        raise NoDataError(f"no {what} on the bus: is sim running?")
    return received.message


def _pixels(image: RawImage) -> Array:
    rows = np.frombuffer(image.data, np.uint8).reshape(image.height, image.step)
    return np.asarray(rows[:, : image.width * 3].reshape(image.height, image.width, 3), dtype=np.float64)
