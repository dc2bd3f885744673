"""The cameras on the bus: frames of one instant under one capture time."""

import logging
import queue
import time
from collections import deque
from collections.abc import Mapping
from functools import partial

from armsight import topics
from armsight.bus import Received
from armsight.frame_pool import FramePool
from armsight.images import encode_sent
from armsight.parameters import Tunable, Value
from armsight.service import Context
from armsight.times import NS_PER_S, from_duration, from_timestamp, to_timestamp, wall_ns
from armsight.v1.sim_pb2 import CLOCK_MODE_LOCKSTEP, Clock
from armsight_camera.arm_clock import ArmClock
from armsight_camera.capture import Capture, Ended, Event, Frame, Lost, Opened, Opener, Unfit
from armsight_camera.condition import Condition, health_of
from armsight_camera.pace import Pace
from armsight_camera.pairing import Instant, Pairing
from armsight_camera.settings import MOST_LATENCY_MS, MOST_SKEW_MS, Settings
from armsight_camera.source import Image, open_source

log = logging.getLogger(__name__)

HAND_OVER_NS = NS_PER_S // 20
"""What may lie between a frame's time and its coming here: decoding a large picture, and a busy machine."""
FILES_HAND_OVER_NS = NS_PER_S
"""The same where there are only files: nobody acts on what they show, and every picture finds its partner."""

_IDLE_S = 0.1
_WAITING_FRAMES = 4
"""Of each camera, while others are being sent."""
_LATELY = 60
"""Instants by which it is told whether the cameras' frames come together."""
_MS = 1_000_000

_APART = (
    "most frames of the cameras are farther apart than --max-skew-ms and go out alone: raise it, or trigger the "
    "cameras together"
)
_LOCKSTEP = "sim runs in lockstep and waits for frames of its own: start it with --external-cameras"


class Cameras:
    """Owns pairing and publishers; what the cameras' threads have comes through a queue."""

    def __init__(self, context: Context, settings: Settings, opener: Opener = open_source) -> None:
        """Says what is known of the cameras; frames start with :meth:`run`."""
        self._context, self._settings, bus = context, settings, context.bus
        names = [device.name for device in settings.devices]
        for name, camera in settings.known.items():
            camera.calibration.timestamp.CopyFrom(to_timestamp(wall_ns()))
            camera.pose.timestamp.CopyFrom(to_timestamp(wall_ns()))
            bus.publisher(topics.CAMERA_CALIBRATION, name).put(camera.calibration)
            bus.publisher(topics.CAMERA_POSE, name).put(camera.pose)
        self._images = {name: bus.publisher(topics.CAMERA_IMAGE, name) for name in names}
        self._pool = FramePool(context.shared_memory, bus.counters)
        self._conditions = {device.name: Condition(device) for device in settings.devices}
        skew_ns = round(settings.max_skew_ms * _MS)
        only_files = all(device.ends for device in settings.devices)
        self._hand_over_ns = FILES_HAND_OVER_NS if only_files else HAND_OVER_NS
        self._pairing: Pairing[Image] = Pairing(names, skew_ns, skew_ns + self._hand_over_ns)
        for device in settings.devices:
            self._pairing.present(device.name, device.ends)  # files are there; devices when they are opened
        self._latency_ns = round(settings.latency_ms * _MS)
        self._clock = ArmClock(wall_ns() - time.monotonic_ns())
        self._clock_changes, self._lockstep, self._last_ns = 0, False, 0
        self._together: deque[bool] = deque(maxlen=_LATELY)
        self._events: queue.Queue[Event] = queue.Queue(_WAITING_FRAMES * len(names))
        self._opener = opener
        self._captures: list[Capture] = []
        context.tunables.declare(
            (
                Tunable(
                    "latency_ms",
                    "from exposure until a frame is grabbed",
                    settings.latency_ms,
                    "ms",
                    0,
                    MOST_LATENCY_MS,
                ),
                Tunable(
                    "max_skew_ms",
                    "that frames of one instant may be apart",
                    settings.max_skew_ms,
                    "ms",
                    0,
                    MOST_SKEW_MS,
                ),
            ),
            self._tune,
        )
        bus.subscriber(topics.CLOCK, on_message=self._hear_clock)

    @property
    def stuck(self) -> bool:
        """Whether a driver still holds a thread that was told to end."""
        return any(capture.thread.is_alive() for capture in self._captures)

    def run(self) -> None:
        """Frame after frame until asked to stop, or until every file has ended.

        Raises:
            SizeError: a camera that is there has pictures of another size than its calibration.
        """
        stop, settings = self._context.stop, self._settings
        pace = Pace(sum(device.ends for device in settings.devices))
        start = partial(
            Capture,
            opener=self._opener,
            events=self._events,
            pace=pace,
            counters=self._context.bus.counters,
            stop=stop,
            loop=settings.loop,
        )
        self._captures = [start(device, settings.wanted[device.name]) for device in settings.devices]
        try:
            while not stop.is_set():
                self._handle_waiting()
                while instant := self._pairing.take(time.monotonic_ns()):
                    self._send(instant)
                self._report()
                if all(condition.ended for condition in self._conditions.values()) and self._pairing.due_ns() is None:
                    return
        finally:
            stop.set()
            until = time.monotonic() + 0.5
            for capture in self._captures:
                capture.thread.join(timeout=max(0.0, until - time.monotonic()))

    def _handle_waiting(self) -> None:
        """Waits for what happens next, and handles all that has: a partner may wait behind."""
        due_ns = self._pairing.due_ns()
        wait_s = _IDLE_S if due_ns is None else (due_ns - time.monotonic_ns()) / NS_PER_S
        try:
            self._handle(self._events.get(timeout=min(_IDLE_S, max(0.0, wait_s))))
            for _ in range(self._events.maxsize):
                self._handle(self._events.get_nowait())
        except queue.Empty:
            return

    def _handle(self, event: Event) -> None:
        condition, now_s = self._conditions[event.camera], time.monotonic()
        match event:
            case Frame():
                condition.took(event.grabbed_ns / NS_PER_S, now_s, wall_ns())
                if not self._pairing.add(event.camera, event.grabbed_ns, event.image):
                    self._context.bus.counters.add("frames_late")
            case Opened():
                condition.opened(event.refused, now_s, wall_ns())
                self._pairing.present(event.camera, True)
                if event.refused:
                    log.warning("%s: its driver did not take %s", condition.device, ", ".join(event.refused))
            case Lost():
                self._pairing.present(event.camera, False)
                if condition.lost(event.reason, wall_ns()):
                    self._context.bus.counters.add("cameras_lost")
                    log.warning("%s is gone: %s", condition.device, event.reason)
            case Unfit():
                raise event.error
            case Ended():
                condition.ended = True
                self._pairing.present(event.camera, False)

    def _send(self, instant: Instant[Image]) -> None:
        counters, health = self._context.bus.counters, self._context.health
        changes = self._clock.changes
        capture_ns = self._clock.capture_ns(instant.time_ns - self._latency_ns)
        if changes != self._clock_changes:  # another clock: its times have nothing to do with those before
            counters.add("clock_changes", changes - self._clock_changes)
            self._clock_changes = changes
        elif capture_ns <= self._last_ns:
            counters.add("frames_backwards", len(instant.frames))
            return
        self._last_ns = capture_ns
        for name, image in instant.frames.items():
            height, width, _ = image.shape
            frame_id = self._settings.known[name].frame_id
            encoded = self._pool.encode_rgb8(image.reshape(-1).data, width, height, frame_id, capture_ns)
            self._images[name].put_bytes(encoded, encode_sent(wall_ns()))
        counters.add("frames_sent", len(instant.frames))
        if len(self._images) > 1:
            alone = len(instant.frames) == 1
            if alone:
                counters.add("frames_unpaired")
            if sum(condition.here and not condition.ended for condition in self._conditions.values()) > 1:
                self._together.append(not alone)
            health.gauge("skew_ms", instant.skew_ns / _MS)

    def _report(self) -> None:
        for name, condition in self._conditions.items():
            self._context.health.gauge(f"rate_hz_{name}", condition.rate_hz())
        apart = len(self._together) == _LATELY and sum(self._together) < _LATELY / 2
        remark = _LOCKSTEP if self._lockstep else _APART if apart else ""
        self._context.health.report(*health_of(self._conditions.values(), time.monotonic(), remark))

    def _hear_clock(self, received: Received[Clock]) -> None:
        self._lockstep = received.message.mode == CLOCK_MODE_LOCKSTEP
        said = received.message
        period_ns = round(from_duration(said.period) * NS_PER_S)
        self._clock.heard(from_timestamp(said.capture_time), round(received.received_s * NS_PER_S), period_ns)

    def _tune(self, values: Mapping[str, Value]) -> None:
        self._latency_ns = round(float(values["latency_ms"]) * _MS)
        self._pairing.max_skew_ns = round(float(values["max_skew_ms"]) * _MS)
        self._pairing.patience_ns = self._pairing.max_skew_ns + self._hand_over_ns
