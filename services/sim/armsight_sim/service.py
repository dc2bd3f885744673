"""The simulation on the bus: frames out, commands in."""

import os
import queue
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from math import pi, sin
from typing import TypeVar

import numpy as np
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Point3InFrame_pb2 import Point3InFrame

from armsight import topics
from armsight.bus import Received
from armsight.calibration import KnownCamera, optical_frame, recoloured
from armsight.frame_pool import FramePool
from armsight.images import encode_sent
from armsight.parameters import Value
from armsight.schema import descriptor_set
from armsight.service import Context
from armsight.times import from_timestamp, to_duration, to_timestamp, wall_ns
from armsight.topics import Query
from armsight.v1.health_pb2 import HEALTH_STATUS_DEGRADED, HEALTH_STATUS_OK, HEALTH_STATUS_WAITING
from armsight.v1.joints_pb2 import JointCommand
from armsight.v1.safety_pb2 import STOP_ACTION_RELEASE, StopRequest, StopResponse
from armsight.v1.sim_pb2 import CLOCK_MODE_LOCKSTEP, CLOCK_MODE_REALTIME, Clock, ResetRequest, ResetResponse
from armsight_sim import description
from armsight_sim.cameras import Cameras, Commission, Noise, picture_size
from armsight_sim.clock import ClockMode, Instants, Lockstep, Pacer
from armsight_sim.commands import Verdict
from armsight_sim.errors import RenderError, SimError
from armsight_sim.motion import Motion
from armsight_sim.painters import Painters
from armsight_sim.recalibration import recalibration_of
from armsight_sim.settings import Settings
from armsight_sim.stop import StopRequestError, StopSources
from armsight_sim.targets import NONE, TARGETS, VISIBLE, visible_box, visible_sphere
from armsight_sim.tip_path import mocap_rows, targets_of
from armsight_sim.tuning import tunables, tuned
from armsight_sim.world import World, load_model, longer_links

T = TypeVar("T")

_IDLE_S = 0.05
"""How often a waiting loop looks whether it should stop, and at heartbeats."""

_REFUSAL_SHOWN_S = 5.0
_VISIBLE_GROUP = 3
_OWN_TARGETS = 64
"""Capture times that are remembered to tell our own targets from others: two seconds of them."""


class Simulation:
    """Owns the world; everything that touches it runs in the thread of :meth:`run`, requests come through a queue."""

    def __init__(self, context: Context, settings: Settings, *, is_software: bool) -> None:
        """Declares everything on the bus; frames start with :meth:`run`.

        Args:
            context: of the service.
            settings: checked.
            is_software: whether OpenGL is drawn by the processor.
        """
        self._is_software = is_software
        self._context, self._settings, bus = context, settings, context.bus
        described, external = load_model(settings.model), settings.external_cameras
        model = longer_links(described, settings.model_error)
        world = World(model, 1.0 / settings.fps, with_cameras=not external)
        instants = Instants(settings.start_ns, settings.fps)
        pose = world.within_limits(settings.pose) if settings.pose else np.zeros(len(world.joint_names))
        self._motion = Motion(world, instants, pose, external_cameras=bool(external))
        self._instants, self._model = instants, model
        self._stops = StopSources()
        self._events: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._lockstep = Lockstep()
        self._last_accepted: bytes = b""
        self._refused_s, self._refused = -_REFUSAL_SHOWN_S, ""
        self._frame_times: deque[float] = deque(maxlen=31)

        # of its own cameras: others say themselves what they see, and how
        self._names = [] if external else description.camera_names(model)
        self._sizes = [picture_size(model, name, settings.width, settings.height) for name in self._names]
        known = recalibration_of(settings, described)
        for name, (width, height) in zip(self._names, self._sizes, strict=True):
            told = known.cameras.get(name, KnownCamera())
            calibration = told.calibration or description.calibration(model, name, width, height, settings.start_ns)
            bus.publisher(topics.CAMERA_CALIBRATION, name).put(calibration)
            stands = told.pose or description.camera_pose(model, name, settings.start_ns)
            bus.publisher(topics.CAMERA_POSE, name).put(stands)
        self._targets = TARGETS if settings.model is None else targets_of(described)
        self._bodies = mocap_rows(model) if settings.target == VISIBLE else None
        arm = description.describe_arm(described, self._bodies is not None, external)
        bus.publisher(topics.DESCRIPTION).put(recoloured(arm, known))
        block = settings.clock is ClockMode.LOCKSTEP
        self._images = [bus.publisher(topics.CAMERA_IMAGE, name, block=block) for name in self._names]
        self._frame_ids = [optical_frame(name) for name in self._names]
        self._pool = FramePool(context.shared_memory, bus.counters)
        # the last pictures: as the cameras draw them, and as the pool takes them
        self._pixels = [bytearray(width * height * 3) for width, height in self._sizes]
        self._pictures = [
            np.frombuffer(pixels, np.uint8).reshape(height, width, 3)
            for pixels, (width, height) in zip(self._pixels, self._sizes, strict=True)
        ]
        self._true = bus.publisher(topics.JOINTS_TRUE)
        self._accepted = bus.publisher(topics.JOINTS_ACCEPTED)
        self._clock = bus.publisher(topics.CLOCK)
        self._target = bus.publisher(topics.TARGET)
        self._shows_target = settings.target != NONE
        self._own_targets: deque[int] = deque(maxlen=_OWN_TARGETS)
        bus.subscriber(topics.TARGET, on_message=self._target_from_elsewhere)
        self._stop_state = bus.publisher(topics.STOP_STATE)
        self._stop_state.put(self._stops.message())
        bus.subscriber(
            topics.JOINT_COMMAND,
            keep=4,
            on_message=lambda received: self._events.put(lambda: self._command(received.message)),
        )
        bus.serve(topics.RESET, lambda request: self._ask(lambda: self._reset(request)))
        bus.serve(topics.STOP, lambda request: self._ask(lambda: self._stop(request, topics.STOP)))
        bus.serve(topics.RELEASE, lambda request: self._ask(lambda: self._stop(request, topics.RELEASE)))
        bus.serve(topics.SCHEMA, lambda _: descriptor_set())
        context.tunables.declare(tunables(settings), lambda values: self._ask(lambda: self._tune(values)))
        bus.presence(self._presence)

    def run(self) -> None:
        """Frame after frame until asked to stop.

        Raises:
            RenderError: nothing draws any more.
        """
        try:
            self._run()
        except RenderError:
            if not self._context.stop.is_set():
                raise

    def _run(self) -> None:
        self._cameras, self._noise = self._new_cameras(self._settings), self._new_noise(self._settings)
        try:
            pacer = Pacer(self._settings.fps, time.monotonic())
            while not self._context.stop.is_set():
                self._frame()
                if self._settings.clock is ClockMode.REALTIME:
                    pacer.taken(time.monotonic())
                    self._handle_until(pacer.due_s)
                else:
                    self._handle_until_answered()
                self._motion.next_frame()
        finally:
            self._cameras.close()

    def _new_cameras(self, settings: Settings) -> Cameras | Painters:
        groups = () if self._bodies is None else (_VISIBLE_GROUP,)
        wanted = Commission(
            self._model,
            self._names,
            settings.width,
            settings.height,
            settings.samples,
            emissive=settings.emissive,
            groups=groups,
        )
        painters = settings.painters if settings.painters is not None else self._usual_painters()
        if not painters:
            return Cameras(wanted)
        return Painters(wanted, painters, self._context.bus.counters, self._context.stop)

    def _usual_painters(self) -> int:
        """As many as can work at a time, where pictures are what everything waits for and no GPU draws them."""
        count = min(len(self._names), len(os.sched_getaffinity(0)))
        hurries = self._settings.clock is ClockMode.LOCKSTEP and self._is_software
        return count if hurries and count > 1 else 0

    def _new_noise(self, settings: Settings) -> Noise | None:
        size = max((width * height for width, height in self._sizes), default=0) * 3
        return Noise(settings.noise, size, settings.seed) if settings.noise > 0.0 else None

    def _tune(self, values: Mapping[str, Value]) -> None:
        before, after = self._settings, tuned(self._settings, values)
        if after.samples != before.samples:
            cameras = self._new_cameras(after)
            self._cameras.close()
            self._cameras = cameras
        if after.noise != before.noise:
            self._noise = self._new_noise(after)
        if after.target != before.target:
            self._shows_target = after.target != NONE
        self._settings = after

    def _frame(self) -> None:
        started = time.monotonic()
        self._set_scene(self._instants.elapsed_s(self._motion.frame))
        self._cameras.draw(self._motion.world.data, self._pictures, meanwhile=self._publish_state)
        if self._noise is not None:
            for picture in self._pictures:
                picture[:] = self._noise.add(picture)
        rendered = time.monotonic()
        self._send_frames()
        self._context.health.gauge("render_ms", (rendered - started) * 1e3)
        self._report(rendered)

    def _send_frames(self) -> None:
        capture_ns, frames = self._motion.capture_ns, zip(self._pixels, self._sizes, self._frame_ids, strict=True)
        for publisher, (pixels, size, frame_id) in zip(self._images, frames, strict=True):
            encoded = self._pool.encode_rgb8(pixels, *size, frame_id, capture_ns)
            publisher.put_bytes(encoded, encode_sent(wall_ns()))
        self._lockstep.sent(capture_ns, time.monotonic())

    def _publish_state(self) -> None:
        world, capture_ns = self._motion.world, self._motion.capture_ns
        stamp = to_timestamp(capture_ns)
        joints = [
            JointState(name=name, position=angle, velocity=speed)
            for name, angle, speed in zip(world.joint_names, world.angles(), world.speeds(), strict=True)
        ]
        self._true.put(JointStates(timestamp=stamp, joints=joints))
        self._publish_accepted(capture_ns)
        lockstep = self._settings.clock is ClockMode.LOCKSTEP
        self._clock.put(
            Clock(
                capture_time=stamp,
                mode=CLOCK_MODE_LOCKSTEP if lockstep else CLOCK_MODE_REALTIME,
                frame=self._motion.frame,
                period=to_duration(1.0 / self._settings.fps),
                speed=self._rate_hz() / self._settings.fps,
            )
        )
        if self._shows_target:
            frame_id, point = self._targets[self._settings.target]
            message = Point3InFrame(timestamp=stamp, frame_id=frame_id)
            message.point.x, message.point.y, message.point.z = point(self._instants.elapsed_s(self._motion.frame))
            self._own_targets.append(capture_ns)
            self._target.put(message)

    def _target_from_elsewhere(self, received: Received[Point3InFrame]) -> None:
        """Somebody else has a target for the arm: the demonstration ends, or the two would pull it to and fro."""
        if from_timestamp(received.message.timestamp) in self._own_targets:
            return
        point = received.message.point
        if not np.isfinite([point.x, point.y, point.z]).all():  # nobody goes there
            self._context.bus.counters.add("target_refused")
        else:
            self._shows_target = False

    def _publish_accepted(self, capture_ns: int) -> None:
        accepted = self._motion.accepted
        if accepted.tobytes() == self._last_accepted:
            return
        self._last_accepted = accepted.tobytes()
        joints = [
            JointState(name=name, position=angle)
            for name, angle in zip(self._motion.world.joint_names, accepted, strict=True)
        ]
        self._accepted.put(JointStates(timestamp=to_timestamp(capture_ns), joints=joints))

    def _set_scene(self, elapsed_s: float) -> None:
        ambient = self._settings.ambient
        self._cameras.light(0.4 + 0.3 * sin(pi * elapsed_s / 30) if ambient is None else ambient)
        if self._bodies is not None:
            data = self._motion.world.data
            data.mocap_pos[list(self._bodies)] = [visible_sphere(elapsed_s), visible_box(elapsed_s)]
            self._motion.world.update_positions()

    def _handle_until(self, due_s: float) -> None:
        """Handles what arrives until the next frame is due, each at the simulated time of its arrival."""
        period_s, steps = 1.0 / self._settings.fps, self._motion.world.steps_per_frame

        def advance() -> None:
            share = 1.0 - (due_s - time.monotonic()) / period_s
            self._motion.advance(int(share * steps))

        while not self._context.stop.is_set():
            now = time.monotonic()
            if now >= due_s:
                return
            self._handle_one(due_s - now, arrived=advance)
            advance()

    def _handle_until_answered(self) -> None:
        while self._lockstep.waiting and not self._context.stop.is_set():
            self._handle_one(_IDLE_S)
            if self._lockstep.resend_due(time.monotonic()):
                self._context.bus.counters.add("frames_sent_again")
                self._send_frames()
                detail = "no answer to the last frames yet: are vision and control running?"
                self._context.health.report(HEALTH_STATUS_WAITING, detail)

    def _handle_one(self, timeout_s: float, arrived: Callable[[], None] = lambda: None) -> None:
        """Waits for an event and handles it; ``arrived`` is called before."""
        try:
            event = self._events.get(timeout=min(timeout_s, _IDLE_S))
        except queue.Empty:
            pass
        else:
            arrived()
            event()
        if self._stops.check_heartbeats(time.monotonic(), wall_ns()):
            self._stop_changed()

    def _command(self, command: JointCommand) -> None:
        self._lockstep.answered(from_timestamp(command.answers))
        decision = self._motion.command(command, stopped=self._stops.stopped)
        if decision.verdict is Verdict.REFUSE:
            self._context.bus.counters.add(f"command_refused_{decision.reason}")
            self._refused = f"last refused command: {decision.reason}: {decision.detail}"
            self._refused_s = time.monotonic()
        else:
            self._context.bus.counters.add(f"command_{decision.verdict.value}")

    def _reset(self, request: ResetRequest) -> ResetResponse:
        named = {joint.name: joint.position_rad for joint in request.joints}
        if len(named) != len(request.joints):
            raise SimError("a joint is named twice")
        first_ns = self._motion.reset(self._motion.world.pose(named))
        self._publish_accepted(first_ns)
        return ResetResponse(capture_time=to_timestamp(first_ns))

    def _stop(self, request: StopRequest, asked: Query[StopRequest, StopResponse]) -> StopResponse:
        # on keys of their own, so that a router can tell who may stop from who may release
        if (request.action == STOP_ACTION_RELEASE) != (asked is topics.RELEASE):
            raise StopRequestError(f"RELEASE is asked on {topics.RELEASE.key}, all else on {topics.STOP.key}")
        if self._stops.handle(request, time.monotonic(), wall_ns()):
            self._stop_changed()
        return StopResponse(state=self._stops.message())

    def _stop_changed(self) -> None:
        if self._stops.stopped:
            self._motion.halt()
        self._stop_state.put(self._stops.message())

    def _presence(self, name: str, here: bool) -> None:
        if here and name in ("vision", "control"):
            self._events.put(lambda: self._lockstep.reader_appeared(time.monotonic()))

    def _ask(self, action: Callable[[], T]) -> T:
        """Runs an action in the simulation's thread and waits for what comes of it."""
        answer: Future[T] = Future()

        def act() -> None:
            try:
                answer.set_result(action())
            except Exception as error:
                answer.set_exception(error)

        self._events.put(act)
        return answer.result(timeout=4.0)

    def _rate_hz(self) -> float:
        times = self._frame_times
        return (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else 0.0

    def _report(self, now: float) -> None:
        self._frame_times.append(now)
        health, rate, fps = self._context.health, self._rate_hz(), self._settings.fps
        health.gauge("rate_hz", rate)
        health.gauge("speed", rate / fps)
        health.gauge("watchdog_trips", self._motion.watchdog_trips)
        health.gauge("stopped", float(self._stops.stopped))
        detail = self._refused if now - self._refused_s < _REFUSAL_SHOWN_S else ""
        full = len(self._frame_times) == self._frame_times.maxlen
        if self._settings.clock is ClockMode.REALTIME and full and rate < 0.8 * fps:
            slow = f"only {rate:.0f} of {fps} frames a second: render smaller frames or fewer samples"
            health.report(HEALTH_STATUS_DEGRADED, slow)
        else:
            health.report(HEALTH_STATUS_OK, detail)
