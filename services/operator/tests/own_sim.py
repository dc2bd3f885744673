"""A sim as somebody could bring one: grey frames, lockstep, an arm without mass. Broken by overriding."""

import math
import queue
import threading
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from armsight import topics
from armsight.bus import Bus
from armsight.errors import ArmsightError
from armsight.images import encode_rgb8
from armsight.parameters import Tunable
from armsight.schema import descriptor_set
from armsight.service import HealthReporter, serve_parameters
from armsight.times import from_duration, from_timestamp, to_duration, to_timestamp, wall_ns
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.health_pb2 import HEALTH_STATUS_OK
from armsight.v1.joints_pb2 import JointCommand
from armsight.v1.safety_pb2 import STOP_ACTION_RELEASE, StopRequest, StopResponse, StopSource, StopState
from armsight.v1.sim_pb2 import CLOCK_MODE_LOCKSTEP, Clock, ResetRequest, ResetResponse
from armsight_operator.conformance import scene
from armsight_operator.conformance.draw import Camera

Array = npt.NDArray[np.float64]
PERIOD_NS = 33_333_333
WATCHDOG_NS = 100_000_000
RESEND_S = 0.3


class OwnSim:
    """Sends the frames of an instant, waits for the command that answers it, steps."""

    service: ClassVar[str] = "sim"

    def __init__(self, bus: Bus) -> None:
        self.bus, self.lock = bus, threading.RLock()
        self.described = self.describe()
        self.names = [joint.name for joint in self.described.joints]
        self.limits = np.array([(joint.lower_rad, joint.upper_rad) for joint in self.described.joints])
        self.q = np.zeros(len(self.names))
        self.goal = self.q.copy()
        self.now_ns, self.frame = wall_ns(), 0
        self.moved_ns, self.last_ns = 0, 0
        self.stopped_by: set[str] = set()
        self.events: queue.SimpleQueue[JointCommand] = queue.SimpleQueue()
        self.cameras = [Camera(n, np.array([9.0, 0, 2]), np.zeros(3), 32, 24, 1.0) for n in ("1", "2")]
        self.declare_parameters()
        bus.publisher(topics.DESCRIPTION).put(self.described)
        for camera in self.cameras:
            bus.publisher(topics.CAMERA_CALIBRATION, camera.name).put(self.calibration(camera))
            bus.publisher(topics.CAMERA_POSE, camera.name).put(camera.pose(self.now_ns))
        self.images = {camera.name: bus.publisher(topics.CAMERA_IMAGE, camera.name) for camera in self.cameras}
        self.true = bus.publisher(topics.JOINTS_TRUE)
        self.accepted = bus.publisher(topics.JOINTS_ACCEPTED)
        self.clock = bus.publisher(topics.CLOCK)
        self.stop_state = bus.publisher(topics.STOP_STATE)
        self.tell_stop()
        bus.subscriber(topics.JOINT_COMMAND, keep=16, on_message=lambda got: self.events.put(got.message))
        bus.serve(topics.STOP, self.stop)
        bus.serve(topics.RELEASE, self.release)
        bus.serve(topics.RESET, self.reset)
        bus.serve(topics.SCHEMA, lambda _: self.schema())
        self.health: Any = self.new_health()
        threading.Thread(target=self.loop, daemon=True).start()

    def new_health(self) -> Any:
        health = HealthReporter(self.service, self.bus)
        health.report(HEALTH_STATUS_OK)
        return health

    def declare_parameters(self) -> None:
        tunables = (Tunable("noise", "of each pixel", 0.0, "", 0.0, 16.0),)
        serve_parameters(self.service, self.bus, {}).declare(tunables, lambda _: None)

    def describe(self) -> ArmDescription:
        return scene.description()

    def calibration(self, camera: Camera) -> CameraCalibration:
        return camera.calibration(self.now_ns)

    def schema(self) -> FileDescriptorSet:
        return descriptor_set()

    # --- instant after instant

    def loop(self) -> None:
        while True:  # a daemon: it ends with the test
            with self.lock:
                self.say_state()
                self.say_frames()
            while not self.answered():
                pass
            with self.lock:
                self.step()

    def answered(self) -> bool:
        try:
            command = self.events.get(timeout=RESEND_S)
        except queue.Empty:
            self.say_frames()
            return False
        with self.lock:
            refusal = self.refusal(command)
            if refusal:
                self.count(refusal)
            elif command.hold:
                self.held(command)
            else:
                self.goal = np.array([{j.name: j.position_rad for j in command.joints}[n] for n in self.names])
                self.moved_ns = self.now_ns
                self.tell_accepted()
            if not refusal:
                self.last_ns = from_timestamp(command.answers)
            return from_timestamp(command.answers) == self.now_ns

    def held(self, command: JointCommand) -> None:
        pass

    def step(self) -> None:
        self.now_ns, self.frame = self.now_ns + PERIOD_NS, self.frame + 1
        if self.stopped_by or self.expired():
            self.goal = self.q.copy()
        most = self.fastest() * PERIOD_NS / 1e9
        self.q = self.q + np.clip(self.goal - self.q, -most, most)

    def expired(self) -> bool:
        return self.now_ns - self.moved_ns > WATCHDOG_NS

    def fastest(self) -> float:
        return scene.MAX_SPEED_RAD_S

    def refusal(self, command: JointCommand) -> str:
        answers_ns = from_timestamp(command.answers)
        given = [joint.name for joint in command.joints]
        if self.is_old(answers_ns, command):
            return "stale"
        if answers_ns > self.now_ns:
            return "future"
        if command.hold:
            return ""
        if self.stopped_by:
            return "stopped"
        if sorted(given) != sorted(self.names):
            return "joints"
        q = np.array([{j.name: j.position_rad for j in command.joints}[name] for name in self.names])
        return self.bad_values(q)

    def is_old(self, answers_ns: int, command: JointCommand) -> bool:
        return answers_ns <= self.last_ns or self.now_ns - answers_ns > from_duration(command.valid_for) * 1e9

    def bad_values(self, q: Array) -> str:
        if not np.isfinite(q).all():
            return "not_finite"
        return "limits" if ((q < self.limits[:, 0]) | (q > self.limits[:, 1])).any() else ""

    def count(self, reason: str) -> None:
        self.bus.counters.add(f"command_refused_{reason}")

    # --- what it says

    def say_state(self) -> None:
        self.true.put(self.states(self.q))
        self.tell_accepted()
        stamp, period = to_timestamp(self.now_ns), to_duration(PERIOD_NS / 1e9)
        self.say_clock(Clock(capture_time=stamp, mode=CLOCK_MODE_LOCKSTEP, frame=self.frame, period=period, speed=1.0))

    def say_clock(self, clock: Clock) -> None:
        self.clock.put(clock)

    def say_frames(self) -> None:
        for camera in self.cameras:
            size = camera.width, camera.height
            pixels = bytes([179]) * (3 * size[0] * size[1])
            self.images[camera.name].put_bytes(encode_rgb8(pixels, *size, camera.frame_id, self.now_ns))

    def tell_accepted(self) -> None:
        self.accepted.put(self.states(self.goal))

    def tell_stop(self) -> None:
        sources = [StopSource(name=name, stopped=True) for name in sorted(self.stopped_by)]
        self.stop_state.put(StopState(stopped=bool(sources), sources=sources))

    def states(self, q: Array) -> JointStates:
        joints = [JointState(name=name, position=angle) for name, angle in zip(self.names, q, strict=True)]
        return JointStates(timestamp=to_timestamp(self.now_ns), joints=joints)

    # --- what it answers

    def stop(self, request: StopRequest) -> StopResponse:
        if not request.source or request.action == STOP_ACTION_RELEASE:
            raise ArmsightError("a source stops here, and releases on safety/release")
        return self.changed(self.stopped_by | {request.source})

    def release(self, request: StopRequest) -> StopResponse:
        if request.source not in self.stopped_by:
            raise ArmsightError(f"{request.source} has not stopped the arm")
        return self.changed(self.stopped_by - {request.source})

    def changed(self, stopped_by: set[str]) -> StopResponse:
        with self.lock:
            self.stopped_by = stopped_by
            self.tell_stop()
            sources = [StopSource(name=name, stopped=True) for name in stopped_by]
            return StopResponse(state=StopState(stopped=bool(stopped_by), sources=sources))

    def reset(self, request: ResetRequest) -> ResetResponse:
        with self.lock:
            given = {joint.name: joint.position_rad for joint in request.joints}
            if not set(given) <= set(self.names) or not all(math.isfinite(value) for value in given.values()):
                raise ArmsightError("joints of this arm, and finite angles")
            self.q = np.array([given.get(name, 0.0) for name in self.names])
            self.goal = self.q.copy()
            self.tell_accepted()
            return ResetResponse(capture_time=to_timestamp(self.now_ns + PERIOD_NS))
