"""The service on a private bus: with made-up drivers in this process, and as a process with files."""

import argparse
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from armsight import topics
from armsight.bus import Bus, Received, open_bus
from armsight.errors import ArmsightError
from armsight.service import Context, HealthReporter, serve_parameters
from armsight.session import SessionConfig, open_session
from armsight.times import NS_PER_S, from_timestamp, to_timestamp
from armsight.v1.health_pb2 import HEALTH_STATUS_DEGRADED, HEALTH_STATUS_OK, HEALTH_STATUS_WAITING, Health
from armsight.v1.parameters_pb2 import ParameterValue, SetParametersRequest
from armsight.v1.sim_pb2 import CLOCK_MODE_LOCKSTEP, CLOCK_MODE_REALTIME, Clock
from armsight_camera.devices import Device
from armsight_camera.errors import SizeError, SourceError
from armsight_camera.service import Cameras
from armsight_camera.settings import Settings, Wanted, argument_parser, parse_settings
from armsight_camera.source import Image
from camera_files import HEIGHT, WIDTH, write_calibration, write_folder, write_video

RUN = (sys.executable, "-m", "armsight_camera.main")
PERIOD_S = 0.02


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    router = open_session(
        SessionConfig(mode="router", endpoints=(endpoint,), namespace="", shared_memory="off"), threading.Event()
    )
    assert router is not None
    with router:
        yield endpoint


def connected(endpoint: str) -> Iterator[Bus]:
    session = open_session(SessionConfig(endpoints=(endpoint,), shared_memory="off"), threading.Event())
    assert session is not None
    with open_bus(session) as bus:
        yield bus


@pytest.fixture
def bus(endpoint: str) -> Iterator[Bus]:
    """The listener's."""
    yield from connected(endpoint)


@pytest.fixture
def own(endpoint: str) -> Iterator[Bus]:
    """The service's."""
    yield from connected(endpoint)


class Driver:
    """A camera that gives a frame each period, of one colour, until a test does something to it."""

    def __init__(self, clock: "Shutter") -> None:
        self.refused: tuple[str, ...] = ()
        self.fps: float | None = None
        self.reported: tuple[int, int] | None = (WIDTH, HEIGHT)
        self.image: Image | None = np.full((HEIGHT, WIDTH, 3), 7, dtype=np.uint8)
        self.raises: Exception | None = None
        self.unplugged = threading.Event()
        self.blocked = threading.Event()
        self.delay_s = 0.0
        self._ticks = clock.ticks()
        self.closed = 0

    def size(self) -> tuple[int, int] | None:
        return self.reported

    def grab(self) -> bool:
        if self.blocked.is_set():
            threading.Event().wait()
        self._ticks.get()
        if self.delay_s:
            time.sleep(self.delay_s)  # this camera's phase
        return not self.unplugged.is_set()

    def retrieve(self) -> Image | None:
        if self.raises is not None:
            raise self.raises
        return self.image

    def close(self) -> None:
        self.closed += 1


class Shutter:
    """What triggers all cameras at once."""

    def __init__(self) -> None:
        self._queues: list[queue.SimpleQueue[None]] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def ticks(self) -> "queue.SimpleQueue[None]":
        made: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._queues.append(made)
        return made

    def close(self) -> None:
        self._ended.set()

    def _run(self) -> None:
        while not self._ended.wait(PERIOD_S):
            for each in self._queues:
                if each.empty():  # who is slow misses frames
                    each.put(None)


class Running:
    """The service with two cameras in this process, and what is heard of it."""

    def __init__(self, bus: Bus, own: Bus, folder: Path) -> None:
        self.bus = bus
        self.shutter = Shutter()
        self.drivers = {"1": Driver(self.shutter), "2": Driver(self.shutter)}
        self.absent: set[str] = set()
        self.images: list[RawImage] = []
        self.healths: list[Health] = []
        self.error: ArmsightError | None = None
        bus.subscriber(topics.CAMERA_IMAGE, "*", keep=100, on_message=lambda r: self.images.append(r.message))
        bus.subscriber(topics.HEALTH, "camera", on_message=self._hear)
        self._own, self._folder = own, folder
        self._stop = threading.Event()

    def start(self, *flags: str) -> None:
        file = write_calibration(self._folder / "c.json", "1", "2")
        given = ["--device", "0", "--device", "1", "--calibration", str(file), *flags]
        settings = parse_settings(argument_parser().parse_args(given))
        self._health = HealthReporter("camera", self._own)
        tunables = serve_parameters("camera", self._own, settings.parameters())
        cameras = Cameras(Context(self._own, self._health, self._stop, tunables), settings, self._open)

        def run() -> None:
            try:
                cameras.run()
            except ArmsightError as error:
                self.error = error

        self.thread = threading.Thread(target=run)
        self.thread.start()

    def seconds_to_end(self) -> float:
        began = time.monotonic()
        self._stop.set()
        self.thread.join(5.0)
        return time.monotonic() - began

    def close(self) -> None:
        self.seconds_to_end()
        self._health.close()
        self.shutter.close()
        assert not self.thread.is_alive()

    def until(self, condition: Callable[[], Any], what: str, timeout_s: float = 10.0) -> None:
        deadline = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline, f"not within {timeout_s:g} s: {what}; last health {self.healths[-1:]}"
            time.sleep(0.01)

    def says(self, status: int, *words: str) -> None:
        self.until(
            lambda: (
                self.healths
                and self.healths[-1].status == status
                and all(word in self.healths[-1].detail for word in words)
            ),
            f"health {status} with {words}",
        )

    def counts(self, name: str, least: int = 1) -> None:
        self.until(lambda: self.healths and self.healths[-1].counters.get(name, 0) >= least, f"{name} is counted")

    def seen(self, camera: str) -> int:
        return sum(image.frame_id == f"camera_{camera}_optical" for image in list(self.images))

    def next_of(self, camera: str, what: str) -> None:
        before = self.seen(camera)
        self.until(lambda: self.seen(camera) > before + 3, what)

    def _hear(self, received: Received[Health]) -> None:
        self.healths.append(received.message)

    def _open(self, device: Device, wanted: Wanted) -> Driver:
        del wanted
        if device.name in self.absent:
            raise SourceError(f"{device.source} can't be opened")
        driver = self.drivers[device.name]
        if driver.unplugged.is_set():
            raise SourceError(f"{device.source} can't be opened")
        return driver


@pytest.fixture
def cameras(bus: Bus, own: Bus, tmp_path: Path) -> Iterator[Running]:
    running = Running(bus, own, tmp_path)
    yield running
    running.close()


def test_frames_of_an_instant_share_a_capture_time_that_only_goes_up(cameras: Running) -> None:
    cameras.start()
    cameras.until(lambda: len(cameras.images) > 60, "frames come")
    by_time: dict[int, set[str]] = {}
    for image in list(cameras.images)[10:50]:
        by_time.setdefault(from_timestamp(image.timestamp), set()).add(image.frame_id)
    together = [names for names in by_time.values() if len(names) == 2]
    assert len(together) >= 0.8 * len(by_time), "threads of one process are rarely 10 ms apart"
    for camera in ("1", "2"):
        times = [from_timestamp(i.timestamp) for i in cameras.images if i.frame_id == f"camera_{camera}_optical"]
        assert times == sorted(set(times))
    image = cameras.images[0]
    assert (image.width, image.height, image.step, image.encoding) == (WIDTH, HEIGHT, 3 * WIDTH, "rgb8")
    assert len(image.data) == 3 * WIDTH * HEIGHT
    cameras.says(HEALTH_STATUS_OK)


def test_capture_time_is_unix_time_less_the_latency_where_there_is_no_clock(cameras: Running) -> None:
    cameras.start("--latency-ms", "500")
    cameras.until(lambda: len(cameras.images) > 4, "frames come")
    cameras.images.clear()
    cameras.until(lambda: cameras.images, "a frame comes")
    age_s = (time.time_ns() - from_timestamp(cameras.images[0].timestamp)) / NS_PER_S
    assert 0.5 < age_s < 0.8


def test_capture_time_is_on_the_arms_clock(cameras: Running, bus: Bus) -> None:
    clock, start_ns = bus.publisher(topics.CLOCK), 1_000_000 * NS_PER_S
    cameras.start()
    cameras.until(lambda: cameras.images, "frames come")
    began = time.monotonic_ns()
    for _ in range(5):
        now = to_timestamp(start_ns + time.monotonic_ns() - began)
        clock.put(Clock(capture_time=now, mode=CLOCK_MODE_REALTIME))
    cameras.until(lambda: from_timestamp(cameras.images[-1].timestamp) < start_ns + 60 * NS_PER_S, "the arm's clock")
    image_ns, now_ns = from_timestamp(cameras.images[-1].timestamp), start_ns + time.monotonic_ns() - began
    assert 0 < now_ns - image_ns < NS_PER_S // 2
    cameras.counts("clock_changes")


def test_sim_in_lockstep_is_told_of(cameras: Running, bus: Bus) -> None:
    cameras.start()
    clock = bus.publisher(topics.CLOCK)
    cameras.until(lambda: cameras.images, "frames come")
    clock.put(Clock(capture_time=to_timestamp(time.time_ns()), mode=CLOCK_MODE_LOCKSTEP))
    cameras.says(HEALTH_STATUS_DEGRADED, "lockstep", "--external-cameras")


def test_unplugged_camera_is_told_of_and_the_other_goes_on_until_it_is_back(cameras: Running) -> None:
    cameras.start()
    cameras.next_of("2", "both deliver")
    cameras.drivers["2"].unplugged.set()
    cameras.says(HEALTH_STATUS_DEGRADED, "camera 2 (/dev/video1) is gone since 20")
    cameras.counts("cameras_lost")
    assert cameras.drivers["2"].closed >= 1, "the driver is let go"
    cameras.next_of("1", "the other goes on")
    cameras.drivers["2"].unplugged.clear()
    cameras.next_of("2", "it is back")
    cameras.says(HEALTH_STATUS_OK)


def test_camera_that_is_absent_at_the_start_is_waited_for(cameras: Running) -> None:
    cameras.absent.add("2")
    cameras.start()
    cameras.says(HEALTH_STATUS_DEGRADED, "camera 2 (/dev/video1) is not there yet")
    cameras.next_of("1", "the other goes on")
    cameras.absent.clear()
    cameras.next_of("2", "it comes")
    cameras.says(HEALTH_STATUS_OK)


def test_without_any_camera_the_service_waits(cameras: Running) -> None:
    cameras.absent.update("12")
    cameras.start()
    cameras.says(HEALTH_STATUS_WAITING, "camera 1", "camera 2")


def test_frame_that_cannot_be_decoded_is_counted_and_the_next_one_comes(cameras: Running) -> None:
    cameras.start()
    cameras.next_of("1", "frames come")
    good, cameras.drivers["1"].image = cameras.drivers["1"].image, None
    cameras.counts("frames_undecoded")
    cameras.drivers["1"].image = good
    cameras.next_of("1", "frames come again")


def test_frame_of_another_size_is_counted_and_never_sent(cameras: Running) -> None:
    cameras.start()
    cameras.next_of("1", "frames come")
    cameras.drivers["1"].image = np.zeros((HEIGHT, 2 * WIDTH, 3), dtype=np.uint8)
    cameras.counts("frames_of_another_size")
    cameras.says(HEALTH_STATUS_DEGRADED, "camera 1 (/dev/video0)", f"{2 * WIDTH} x {HEIGHT}", "calibrate")
    assert {image.width for image in list(cameras.images)} == {WIDTH}
    cameras.next_of("2", "the other goes on")


def test_stream_that_says_no_size_and_whose_pictures_have_another_one_is_refused(cameras: Running) -> None:
    cameras.drivers["2"].reported = None
    cameras.drivers["2"].image = np.zeros((HEIGHT, 2 * WIDTH, 3), dtype=np.uint8)
    cameras.start()
    cameras.thread.join(5.0)
    assert isinstance(cameras.error, SizeError)


def test_driver_that_fails_in_any_way_is_opened_again(cameras: Running) -> None:
    cameras.start()
    cameras.next_of("1", "frames come")
    cameras.drivers["1"].raises = RuntimeError("nobody thought of that")
    cameras.says(HEALTH_STATUS_DEGRADED, "nobody thought of that")
    cameras.counts("failed_capture")
    cameras.drivers["1"].raises = None
    cameras.next_of("1", "frames come again")


def test_device_that_does_not_have_the_calibrated_size_is_refused(cameras: Running) -> None:
    cameras.drivers["2"].reported = (1280, 720)
    cameras.start()
    cameras.thread.join(5.0)
    assert isinstance(cameras.error, SizeError)
    assert "1280 x 720" in str(cameras.error)
    assert f"{WIDTH} x {HEIGHT}" in str(cameras.error)
    assert cameras.seen("2") == 0


def test_silent_driver_is_told_of_and_does_not_keep_the_service_from_ending(cameras: Running) -> None:
    cameras.start()
    cameras.next_of("1", "frames come")
    cameras.drivers["1"].blocked.set()
    cameras.says(HEALTH_STATUS_DEGRADED, "camera 1 (/dev/video0) is there, and gives no frames since")
    cameras.next_of("2", "the other goes on")
    assert cameras.seconds_to_end() < 2.0


def test_cameras_that_are_never_together_are_told_of_and_their_frames_go_out_alone(cameras: Running) -> None:
    cameras.drivers["2"].delay_s = PERIOD_S / 2
    cameras.start("--max-skew-ms", "0.1")
    cameras.counts("frames_unpaired", 60)
    cameras.says(HEALTH_STATUS_DEGRADED, "--max-skew-ms")
    assert cameras.seen("1") > 10
    assert cameras.seen("2") > 10


def test_setting_that_the_driver_did_not_take_is_said_in_health(cameras: Running) -> None:
    cameras.drivers["1"].refused = ("exposure 120 (is 157)",)
    cameras.start("--exposure", "120")
    cameras.says(HEALTH_STATUS_OK, "camera 1", "exposure 120 (is 157)")


def test_latency_can_be_set_while_it_runs(cameras: Running, bus: Bus) -> None:
    cameras.start()
    cameras.until(lambda: cameras.images, "frames come")
    request = SetParametersRequest(values={"latency_ms": ParameterValue(number=300.0)})
    answer = bus.query(topics.SET_PARAMETERS, request, "camera")
    assert {parameter.name for parameter in answer.parameters} == {"latency_ms", "max_skew_ms"}
    cameras.until(lambda: _age_s(cameras.images[-1]) > 0.3, "capture times are earlier")


def _age_s(image: RawImage) -> float:
    return (time.time_ns() - from_timestamp(image.timestamp)) / NS_PER_S


# --- as a process


@pytest.fixture
def start(endpoint: str) -> Iterator[Callable[..., "subprocess.Popen[str]"]]:
    started: list[subprocess.Popen[str]] = []

    def run(*flags: str) -> "subprocess.Popen[str]":
        process = subprocess.Popen([*RUN, "--connect", endpoint, *flags], stderr=subprocess.PIPE, text=True)
        started.append(process)
        return process

    yield run
    for process in started:
        process.kill()
        process.communicate()


def test_files_are_sent_to_their_end_in_pairs_and_then_it_ends_well(
    bus: Bus, start: Callable[..., "subprocess.Popen[str]"], tmp_path: Path
) -> None:
    shades = [10, 60, 110, 160, 210]
    folder = write_folder(tmp_path / "f", shades)
    video = write_video(tmp_path / "v.avi", shades)
    file = write_calibration(tmp_path / "c.json", "1", "left")
    images: list[RawImage] = []
    healths: list[Health] = []
    bus.subscriber(topics.CAMERA_IMAGE, "*", keep=100, on_message=lambda received: images.append(received.message))
    bus.subscriber(topics.HEALTH, "camera", on_message=lambda received: healths.append(received.message))
    process = start("--device", str(folder), "--device", f"left={video}", "--fps", "10", "--calibration", str(file))
    _, said = process.communicate(timeout=30)
    assert process.returncode == 0, said
    pairs: dict[int, dict[str, float]] = {}
    for image in images:
        shade = float(np.frombuffer(image.data, np.uint8)[::3].mean())
        pairs.setdefault(from_timestamp(image.timestamp), {})[image.frame_id] = shade
    expected = [{"camera_1_optical": shade, "camera_left_optical": pytest.approx(shade, abs=4)} for shade in shades]
    assert [pairs[at] for at in sorted(pairs)] == expected
    times = sorted(pairs)
    assert np.diff(times) == pytest.approx([NS_PER_S / 10] * 4, rel=0.01)
    assert healths[-1].status == HEALTH_STATUS_OK
    assert "all files were sent" in healths[-1].detail
    assert healths[-1].counters["frames_sent"] == 2 * len(shades)


def test_late_reader_gets_calibration_and_pose_and_looping_goes_on(
    bus: Bus, start: Callable[..., "subprocess.Popen[str]"], tmp_path: Path
) -> None:
    file = write_calibration(tmp_path / "c.json", "1")
    folder = write_folder(tmp_path / "f", [1, 2, 3])
    process = start("--device", str(folder), "--loop", "--fps", "60", "--calibration", str(file))
    images = bus.subscriber(topics.CAMERA_IMAGE, "1", keep=100)
    for _ in range(10):
        assert images.recv(10.0) is not None
    calibration = bus.subscriber(topics.CAMERA_CALIBRATION, "1").recv(5.0)
    pose = bus.subscriber(topics.CAMERA_POSE, "1").recv(5.0)
    assert calibration is not None
    assert (calibration.message.width, calibration.message.frame_id) == (WIDTH, "camera_1_optical")
    assert pose is not None
    assert (pose.message.parent_frame_id, pose.message.child_frame_id) == ("world", "camera_1_optical")
    process.send_signal(signal.SIGTERM)
    assert process.wait(2.0) == 0


def test_sigterm_ends_it_while_the_driver_blocks(
    bus: Bus, start: Callable[..., "subprocess.Popen[str]"], tmp_path: Path
) -> None:
    file = write_calibration(tmp_path / "c.json", "1")
    with socket.socket() as silent:  # takes connections and never says a word
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        healths = bus.subscriber(topics.HEALTH, "camera")
        url = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        process = start("--device", url, "--calibration", str(file))
        silent.settimeout(15.0)
        connection, _ = silent.accept()
        with connection:
            assert healths.recv(10.0) is not None
            process.send_signal(signal.SIGTERM)
            assert process.wait(2.0) == 0


@pytest.mark.parametrize(
    ("flags", "reason"),
    [
        (("--device", "{small}"), "32 x 24"),
        (("--device", "{broken}"), "can't be opened"),
        (("--device", "{empty}"), "none of its pictures"),
        (("--device", "{undecodable}"), "none of its pictures"),
        (("--device", "0", "--calibration", "{absent}"), "can't be read"),
    ],
    ids=["another size", "no video", "no frames", "no pictures", "no calibration"],
)
def test_what_cannot_be_used_is_refused_before_it_starts(flags: Sequence[str], reason: str, tmp_path: Path) -> None:
    file = write_calibration(tmp_path / "c.json", "1")
    write_folder(tmp_path / "small", [1], width=32, height=24)
    (tmp_path / "broken.avi").write_bytes(b"nothing")
    (tmp_path / "undecodable").mkdir()
    (tmp_path / "undecodable" / "a.png").write_bytes(b"nothing")
    places = {
        "small": tmp_path / "small",
        "broken": tmp_path / "broken.avi",
        "empty": write_video(tmp_path / "empty.avi", []),
        "undecodable": tmp_path / "undecodable",
        "absent": tmp_path / "absent.json",
    }
    words = [word.format(**places) for word in ("--calibration", str(file), *flags)]
    ended = subprocess.run([*RUN, *words], capture_output=True, text=True, timeout=20, check=False)
    assert ended.returncode == 2
    assert reason in ended.stderr
    assert "Traceback" not in ended.stderr


def test_health_is_asked_without_devices_or_calibration(endpoint: str) -> None:
    asked = subprocess.run(
        [*RUN, "--health", "--connect", endpoint], capture_output=True, text=True, timeout=20, check=False
    )
    assert asked.returncode == 1
    assert "camera" in asked.stderr


def test_settings_hold_what_health_and_parameters_tell(tmp_path: Path) -> None:
    file = write_calibration(tmp_path / "c.json", "left")
    arguments: argparse.Namespace = argument_parser().parse_args(["--device", "left=0", "--calibration", str(file)])
    settings: Settings = parse_settings(arguments)
    assert settings.parameters()["devices"] == {"left": "/dev/video0"}
