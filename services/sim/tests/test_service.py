"""The process on a private bus."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.empty_pb2 import Empty

from armsight import topics
from armsight.bus import Bus, open_bus
from armsight.calibration import CalibrationFile, KnownCamera, write_calibration_file
from armsight.errors import RefusedError
from armsight.session import SessionConfig, open_session
from armsight.times import from_timestamp, to_duration
from armsight.v1.description_pb2 import Color
from armsight.v1.joints_pb2 import JointCommand, JointSetpoint
from armsight.v1.parameters_pb2 import ParameterValue, SetParametersRequest
from armsight.v1.safety_pb2 import STOP_ACTION_RELEASE, STOP_ACTION_STOP, StopRequest
from armsight.v1.sim_pb2 import ResetRequest
from armsight_sim import description
from armsight_sim.world import load_model

EXECUTABLE = Path(sys.executable).parent / "armsight-sim"
START_NS = 1_714_564_800_000_000_000


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


@pytest.fixture
def bus(endpoint: str) -> Iterator[Bus]:
    session = open_session(SessionConfig(endpoints=(endpoint,), shared_memory="off"), threading.Event())
    assert session is not None
    with open_bus(session) as bus:
        yield bus


@pytest.fixture
def sim(endpoint: str) -> Iterator[Callable[..., "subprocess.Popen[bytes]"]]:
    started: list[subprocess.Popen[bytes]] = []

    def start(*flags: str) -> "subprocess.Popen[bytes]":
        small = ("--width", "160", "--height", "160", "--start-time", str(START_NS))
        process = subprocess.Popen([EXECUTABLE, "--connect", endpoint, *small, *flags])
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()


def answer(capture_ns: int, angle: float) -> JointCommand:
    joints = [JointSetpoint(name=f"joint{i}", position_rad=angle if i == 1 else 0.0) for i in range(1, 5)]
    command = JointCommand(valid_for=to_duration(0.1), joints=joints)
    command.answers.FromNanoseconds(capture_ns)
    return command


def taken(subscriber: Any) -> Any:
    received = subscriber.recv(15.0)
    assert received is not None
    return received.message


def test_frames_of_an_instant_share_its_time_and_lockstep_waits_for_the_answer(
    bus: Bus, sim: Callable[..., object]
) -> None:
    images = bus.subscriber(topics.CAMERA_IMAGE, "*", keep=8)
    commands = bus.publisher(topics.JOINT_COMMAND)
    sim("--clock", "lockstep")
    first = {taken(images).frame_id: None for _ in range(2)}
    assert set(first) == {"camera_1_optical", "camera_2_optical"}
    assert images.recv(0.5) is None, "it went on without an answer"
    command = JointCommand(hold=True, valid_for=to_duration(0.1))
    command.answers.FromNanoseconds(START_NS)
    commands.put(command)
    stamps = {from_timestamp(taken(images).timestamp) for _ in range(2)}
    assert stamps == {START_NS + 33_333_333}


def test_late_reader_gets_description_cameras_setpoint_and_stop(bus: Bus, sim: Callable[..., object]) -> None:
    clock = bus.subscriber(topics.CLOCK)
    sim()
    taken(clock)
    assert len(taken(bus.subscriber(topics.DESCRIPTION)).markers) == 4
    assert taken(bus.subscriber(topics.CAMERA_CALIBRATION, "2")).width == 160
    assert taken(bus.subscriber(topics.CAMERA_POSE, "1")).parent_frame_id == "world"
    assert [joint.position for joint in taken(bus.subscriber(topics.JOINTS_ACCEPTED)).joints] == [0, 0, 0, 0]
    assert not taken(bus.subscriber(topics.STOP_STATE)).stopped


def test_reset_shows_the_pose_from_the_instant_it_names(bus: Bus, sim: Callable[..., object]) -> None:
    true = bus.subscriber(topics.JOINTS_TRUE, keep=100)
    sim()
    taken(true)
    request = ResetRequest(joints=[JointSetpoint(name="joint3", position_rad=0.4)])
    first_ns = from_timestamp(bus.query(topics.RESET, request).capture_time)
    while from_timestamp((message := taken(true)).timestamp) < first_ns:
        assert message.joints[2].position == pytest.approx(0.0, abs=1e-6)
    assert from_timestamp(message.timestamp) == first_ns
    assert message.joints[2].position == pytest.approx(0.4, abs=1e-6)
    with pytest.raises(RefusedError, match="joint2"):
        bus.query(topics.RESET, ResetRequest(joints=[JointSetpoint(name="joint2", position_rad=3.0)]))
    with pytest.raises(RefusedError, match="elbow"):
        bus.query(topics.RESET, ResetRequest(joints=[JointSetpoint(name="elbow", position_rad=0.0)]))


def test_stopped_arm_refuses_motion_until_released(bus: Bus, sim: Callable[..., object]) -> None:
    true = bus.subscriber(topics.JOINTS_TRUE)
    health = bus.subscriber(topics.HEALTH, "sim")
    commands = bus.publisher(topics.JOINT_COMMAND)
    sim()
    taken(true)
    bus.query(topics.STOP, StopRequest(action=STOP_ACTION_STOP, source="test"))

    def push(seconds: float) -> float:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            message = taken(true)
            commands.put(answer(from_timestamp(message.timestamp), 0.3))
        return float(message.joints[0].position)

    assert abs(push(0.7)) < 1e-9
    health.clear()
    assert taken(health).counters["command_refused_stopped"] > 5
    # releasing has a key of its own, for rights of its own
    with pytest.raises(RefusedError, match="RELEASE is asked on safety/release"):
        bus.query(topics.STOP, StopRequest(action=STOP_ACTION_RELEASE, source="test"))
    with pytest.raises(RefusedError, match="all else on safety/stop"):
        bus.query(topics.RELEASE, StopRequest(action=STOP_ACTION_STOP, source="test"))
    assert abs(push(0.3)) < 1e-9
    bus.query(topics.RELEASE, StopRequest(action=STOP_ACTION_RELEASE, source="test"))
    assert push(1.0) > 0.2


def test_light_noise_samples_and_target_may_be_set_while_it_runs(bus: Bus, sim: Callable[..., object]) -> None:
    images = bus.subscriber(topics.CAMERA_IMAGE, "1")
    targets = bus.subscriber(topics.TARGET)
    sim("--fps", "60")
    before = pixels(taken(images))

    def tuned(**values: ParameterValue) -> npt.NDArray[np.int16]:
        bus.query(topics.SET_PARAMETERS, SetParametersRequest(values=values), "sim")
        images.clear()
        taken(images)  # may have been under way
        return pixels(taken(images))

    assert (tuned(ambient=ParameterValue(number=0.9)) - before).mean() > 5, "brighter"
    back = tuned(ambient=ParameterValue(number=0.4))
    assert (back == before).all()
    noisy = tuned(noise=ParameterValue(number=10.0)) - before
    assert 5 < noisy.std() < 12
    smooth = tuned(noise=ParameterValue(number=0.0), samples=ParameterValue(whole=4)) - before
    assert 0 < (smooth != 0).mean() < 0.2, "only outlines differ"
    assert targets.recv(0.2) is None
    tuned(target=ParameterValue(text="exercise"))
    assert taken(targets).frame_id == "base"

    for text, value in (
        ("samples 2: a pixel has 0 or 4", {"samples": ParameterValue(whole=2)}),
        ("noise is a number within 0 to 50 grey levels, not 51", {"noise": ParameterValue(number=51)}),
        ("target is one of none, default, exercise", {"target": ParameterValue(text="visible")}),
    ):
        with pytest.raises(RefusedError, match=text):
            bus.query(topics.SET_PARAMETERS, SetParametersRequest(values=value), "sim")


def pixels(image: RawImage) -> npt.NDArray[np.int16]:
    return np.frombuffer(image.data, np.uint8).astype(np.int16)


def test_sigterm_ends_it_within_two_seconds(bus: Bus, sim: Callable[..., "subprocess.Popen[bytes]"]) -> None:
    clock = bus.subscriber(topics.CLOCK)
    process = sim("--clock", "lockstep")
    taken(clock)
    begun = time.monotonic()
    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=5) == 0
    assert time.monotonic() - begun < 2.0


def test_external_cameras_are_described_and_nothing_is_drawn_or_said_of_them(
    bus: Bus, sim: Callable[..., object]
) -> None:
    clock = bus.subscriber(topics.CLOCK)
    said = [
        bus.subscriber(topic, "*") for topic in (topics.CAMERA_CALIBRATION, topics.CAMERA_POSE, topics.CAMERA_IMAGE)
    ]
    sim("--external-cameras", "left", "right")
    for _ in range(10):
        taken(clock)
    assert list(taken(bus.subscriber(topics.DESCRIPTION)).cameras) == ["left", "right"]
    assert [subscriber.latest for subscriber in said] == [None, None, None]
    tunable = bus.query(topics.ASK_PARAMETERS, Empty(), "sim").parameters
    assert [parameter.name for parameter in tunable] == ["target"]


def test_command_between_two_frames_is_taken_at_its_time_with_external_cameras(
    bus: Bus, sim: Callable[..., object]
) -> None:
    # answers of all phases of a frame: none is ahead of simulated time, none too old
    clock = bus.subscriber(topics.CLOCK)
    accepted, healths = bus.subscriber(topics.JOINTS_ACCEPTED), bus.subscriber(topics.HEALTH, "sim")
    commands = bus.publisher(topics.JOINT_COMMAND)
    sim("--external-cameras", "1", "2", "--fps", "15")
    refused: list[dict[str, float]] = [{}]
    sent = clean = seen_ns = 0
    for _ in range(30):
        for phase in range(10):
            tick = clock.recv(15.0)
            assert tick is not None
            threading.Event().wait(phase * 0.005)
            now_ns = from_timestamp(tick.message.capture_time) + round((time.monotonic() - tick.received_s) * 1e9)
            seen_ns = max(now_ns, seen_ns + 1)  # a tick that came late says an earlier time than it is
            threading.Event().wait(0.008)  # vision and control
            commands.put(answer(seen_ns, 0.3))
            sent += 1
        counted: dict[str, float] = {}
        while sum(counted.values()) < sent:
            counters = taken(healths).counters
            counted = {name: total for name, total in counters.items() if name.startswith("command_")}
        refused.append({name: total for name, total in counted.items() if "refused" in name})
        assert set(refused[-1]) <= {"command_refused_stale"}
        # where the machine stands still for a tenth of a second any command is too old: that phase comes again
        clean += refused[-1] == refused[-2]
        if clean == 4:
            break
    assert taken(accepted) is not None
    assert clean == 4, refused


def test_external_cameras_need_no_opengl(endpoint: str, bus: Bus) -> None:
    clock = bus.subscriber(topics.CLOCK)
    # a back end that is not there
    environment = os.environ | {"MUJOCO_GL": "egl", "PYOPENGL_PLATFORM": "egl", "__EGL_VENDOR_LIBRARY_DIRS": "/nowhere"}
    command = [str(EXECUTABLE), "--connect", endpoint, "--external-cameras", "1", "2"]
    with subprocess.Popen(command, env=environment) as process:
        try:
            taken(clock)
        finally:
            process.terminate()


def test_a_calibration_file_reaches_everybody(
    sim: Callable[..., "subprocess.Popen[bytes]"], bus: Bus, tmp_path: Path
) -> None:
    model = load_model()
    calibration = description.calibration(model, "2", 160, 160, 0)
    calibration.K[0] += 3.0
    pose = description.camera_pose(model, "2", 0)
    pose.translation.x += 0.25
    content = CalibrationFile({"2": KnownCamera(calibration, pose)}, {"red": Color(red=0.8, green=0.1, blue=0.1)})
    write_calibration_file(tmp_path / "c.json", content)
    sim("--calibration", str(tmp_path / "c.json"))
    arm, lens, place = (
        bus.subscriber(topics.DESCRIPTION),
        bus.subscriber(topics.CAMERA_CALIBRATION, "2"),
        bus.subscriber(topics.CAMERA_POSE, "2"),
    )
    described, told, stands = arm.recv(20.0), lens.recv(20.0), place.recv(20.0)
    assert described is not None
    assert told is not None
    assert stands is not None
    assert told.message == calibration
    assert stands.message == pose
    assert {m.name: m.color.red for m in described.message.markers}["red"] == 0.8
