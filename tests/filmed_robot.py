"""A robot without a simulation: an arm that rests before two small cameras, filmed as often as is asked for."""

import multiprocessing
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.synchronize import Event

import numpy as np

from armsight import topics
from armsight.bus import Bus, Received, open_bus
from armsight.images import encode_rgb8, encode_sent
from armsight.session import SessionConfig, open_session
from armsight.times import from_timestamp, wall_ns
from armsight.v1.health_pb2 import Health
from armsight.v1.joints_pb2 import JointPositions
from armsight_operator.conformance import scene
from armsight_operator.conformance.draw import Camera
from armsight_operator.conformance.scene import Scene

_CAMERAS = (
    Camera("1", np.array([14.0, 0.0, 5.0]), np.array([0.0, 0.0, 4.5]), 320, 240, 1.1),
    Camera("2", np.array([0.0, -13.0, 5.5]), np.array([0.0, 0.0, 4.5]), 320, 240, 1.2),
)
_POSE = np.array([0.0, 0.0, 0.7, 0.6])
_SPAWN = multiprocessing.get_context("spawn")


class FilmedRobot:
    """Sim's part of one robot's bus, and what vision answers there.

    Args:
        bus: with the robot's namespace.
        described: whether it tells of the arm and its cameras.
    """

    def __init__(self, bus: Bus, *, described: bool = True) -> None:
        self.bus = bus
        self.asked: dict[int, float] = {}
        """Monotonic seconds at which an instant was sent, by capture time."""
        self.answered: dict[int, float] = {}
        """The same of its positions' arrival."""
        self.measured_ms: dict[int, float] = {}
        """From the arrival of an instant's last frame at vision to its positions, by vision's own clock."""
        self.health: Health | None = None
        world = Scene(scene.description(cameras=tuple(camera.name for camera in _CAMERAS)))
        self._images = {camera.name: bus.publisher(topics.CAMERA_IMAGE, camera.name) for camera in _CAMERAS}
        self._pixels = {camera.name: camera.draw(world.balls(_POSE)).tobytes() for camera in _CAMERAS}
        bus.subscriber(topics.JOINT_POSITIONS, keep=64, on_message=self._take_positions)
        bus.subscriber(topics.HEALTH, "vision", on_message=self._take_health)
        if described:
            for camera in _CAMERAS:
                bus.publisher(topics.CAMERA_CALIBRATION, camera.name).put(camera.calibration(wall_ns()))
                bus.publisher(topics.CAMERA_POSE, camera.name).put(camera.pose(wall_ns()))
            bus.publisher(topics.DESCRIPTION).put(world.described)

    def film(self) -> None:
        """One instant."""
        capture_ns = wall_ns()
        self.asked[capture_ns] = time.monotonic()
        for camera in _CAMERAS:
            encoded = encode_rgb8(self._pixels[camera.name], camera.width, camera.height, camera.frame_id, capture_ns)
            self._images[camera.name].put_bytes(encoded, encode_sent(capture_ns))

    def film_for(self, seconds: float, rate_hz: float) -> None:
        """That often, by the clock: whoever is slow is not waited for."""
        began = time.monotonic()
        for index in range(round(seconds * rate_hz)):
            time.sleep(max(0.0, began + index / rate_hz - time.monotonic()))
            self.film()

    def begin(self, timeout_s: float = 20.0) -> None:
        """Films until all of some instants are answered, then forgets them."""
        deadline = time.monotonic() + timeout_s
        while True:
            self.forget()
            self.film_for(0.2, 10)
            if len(self.latencies_ms(0.5)) == len(self.asked):
                break
            assert time.monotonic() < deadline, f"vision does not answer; its health: {self.health}"
        self.forget()

    def forget(self) -> None:
        """What was asked and answered so far."""
        for kept in (self.asked, self.answered, self.measured_ms):
            kept.clear()

    def latencies_ms(self, grace_s: float = 1.0) -> list[float]:
        """Of what was asked and answered so far, once the last answer is there or that long has passed."""
        deadline = time.monotonic() + grace_s
        while not self.asked.keys() <= self.answered.keys() and time.monotonic() < deadline:
            time.sleep(0.01)
        answered = dict(self.answered)
        return [1000 * (answered[key] - sent) for key, sent in self.asked.items() if key in answered]

    def _take_positions(self, received: Received[JointPositions]) -> None:
        capture_ns, stages = from_timestamp(received.message.capture_time), received.message.stages
        self.measured_ms[capture_ns] = (stages.vision_sent_ns - stages.vision_received_ns) / 1e6
        self.answered[capture_ns] = received.received_s

    def _take_health(self, received: Received[Health]) -> None:
        self.health = received.message


@contextmanager
def filmed_robot(endpoint: str, namespace: str, *, described: bool = True) -> Iterator[FilmedRobot]:
    """A robot on a session of its own."""
    config = SessionConfig(endpoints=(endpoint,), namespace=namespace, shared_memory="off")
    session = open_session(config, threading.Event())
    assert session is not None
    with open_bus(session) as bus:
        yield FilmedRobot(bus, described=described)


@contextmanager
def flooding(endpoint: str, namespace: str, rate_hz: float) -> Iterator[None]:
    """Another process films a robot that often, once vision answers it."""
    began, done = _SPAWN.Event(), _SPAWN.Event()
    process = _SPAWN.Process(target=_flood, args=(endpoint, namespace, rate_hz, began, done), daemon=True)
    process.start()
    try:
        assert began.wait(40), "the flood does not begin"
        yield
    finally:
        done.set()
        process.join(10)
        if process.is_alive():
            process.kill()


def _flood(endpoint: str, namespace: str, rate_hz: float, began: Event, done: Event) -> None:
    with filmed_robot(endpoint, namespace) as robot:
        robot.begin()
        began.set()
        while not done.is_set():
            robot.film_for(0.5, rate_hz)
