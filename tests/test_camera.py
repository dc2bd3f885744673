"""Cameras that are not sim's: the whole loop on what armsight-camera brings."""

import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from armsight import topics
from armsight.bus import Received
from armsight.times import from_timestamp
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.joints_pb2 import JointPositions
from armsight_operator.picture import take_snapshot, write_snapshot
from armsight_operator.report.chain import arm_of
from armsight_operator.report.markers import samples_of
from rig import Rig

MakeRig = Callable[..., Rig]

POSE = (0.4, 0.0, 0.7, -0.5)
COPIES = 5
"""Of each picture, in a folder that is played in a loop."""
ALLOWED = 0.05
"""Share of commands that may be refused for their time: where this machine can't keep up, sim falls behind."""
REFUSED = ("future", "stale", "out_of_order", "duplicate")


def draw(make_rig: MakeRig, folder: Path) -> None:
    """Renders the arm at a pose, into a folder for each camera and a file of their calibrations."""
    rig = make_rig(mode="hold", target="none")
    rig.start_all()
    rig.wait_ready()
    shown_ns = rig.reset(POSE)
    rig.wait_until(lambda: abs(rig.true_joints() - POSE).max() < 1e-3 and not rig.moving(), 10, "the arm is there")
    while (snapshot := take_snapshot(rig.bus)).capture_ns < shown_ns:
        pass
    for name, picture in write_snapshot(snapshot, folder).items():
        pictures = folder / name
        pictures.mkdir()
        for number in range(COPIES):
            shutil.copy(picture, pictures / f"{number}.png")
    rig.close()


@contextmanager
def cameras(endpoint: str, folder: Path, *flags: str) -> Iterator["subprocess.Popen[bytes]"]:
    command = [sys.executable, "-m", "armsight_camera.main", "--connect", endpoint]
    command += ["--calibration", str(folder / "calibration.json"), *flags]
    process = subprocess.Popen(command)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def folders(folder: Path) -> Sequence[str]:
    return ("--device", str(folder / "1"), "--device", f"2={folder / '2'}", "--fps", "30", "--loop")


def external(make_rig: MakeRig, **options: object) -> Rig:
    pose = [f"{angle:g}" for angle in POSE]
    sim = ["--pose", *pose, "--external-cameras", "1", "2"]
    return make_rig(mode="hold", target="none", extra={"sim": sim}, **options)


def test_arm_is_measured_and_answered_through_cameras_that_are_not_sims(make_rig: MakeRig, tmp_path: Path) -> None:
    # setup: pictures of a pose, a sim that draws none and stands in that pose, the pictures at 30 a second
    draw(make_rig, tmp_path)
    rig = external(make_rig)
    rig.start_all()
    measured: list[JointPositions] = []
    with cameras(rig.stack.endpoint, tmp_path, *folders(tmp_path)):
        rig.wait_ready()
        described: list[ArmDescription] = []
        rig.bus.subscriber(topics.DESCRIPTION, on_message=lambda received: described.append(received.message))
        rig.bus.subscriber(
            topics.JOINT_POSITIONS, keep=1000, on_message=lambda received: measured.append(received.message)
        )
        before = rig.counters("sim")
        rig.wait_until(lambda: len(measured) > 60 and bool(described), 20, "60 instants are measured")
        rig.wait_until(
            lambda: rig.counters("sim").get("command_hold", 0) >= before.get("command_hold", 0) + 50,
            10,
            "sim is answered",
        )
        counters = rig.counters("sim")
        # invariants: vision is as good as on sim's own frames, sim refuses no command for its time
        arm = arm_of(described[0])
        assert list(described[0].cameras) == ["1", "2"]
        errors = [
            sample.error_m
            for positions in measured
            for sample in samples_of(arm, positions, np.array(POSE), 2)
            if not sample.lost and sample.visible > 0.5
        ]
        assert len(errors) > 100
        print(f"{len(errors)} markers: mean {1e3 * np.mean(errors):.2f} mm, max {1e3 * max(errors):.2f} mm")
        assert max(errors) < 0.02
        refused = sum(counters.get(f"command_refused_{reason}", 0) for reason in REFUSED)
        assert refused <= ALLOWED * counters["command_hold"], counters
        camera = rig.health("camera")
        assert camera.counters.get("frames_unpaired", 0) == 0
        assert camera.gauges["rate_hz_1"] == pytest.approx(30, rel=0.1)
        times = [from_timestamp(positions.capture_time) for positions in measured]
        assert times == sorted(set(times))


def test_command_that_moves_is_taken_and_the_arm_moves(make_rig: MakeRig, tmp_path: Path) -> None:
    draw(make_rig, tmp_path)
    rig = external(make_rig)
    rig.start_all()
    with cameras(rig.stack.endpoint, tmp_path, *folders(tmp_path)):
        rig.wait_ready()
        start = rig.true_joints()
        rig.mode("joints", (POSE[0] + 0.2, *POSE[1:]))
        rig.wait_until(lambda: abs(rig.true_joints() - start).max() > 0.02, 10, "the arm moves")
        rig.wait_until(lambda: rig.counters("sim").get("command_move", 0) > 0, 5, "sim counts commands that move")
        # the pictures never show it moved: control takes the arm for astray at last, and holds
        rig.mode("hold")
        rig.wait_until(lambda: not rig.moving(), 5, "the arm stands")


def test_camera_comes_back_and_ends_within_two_seconds_of_sigterm(make_rig: MakeRig, tmp_path: Path) -> None:
    draw(make_rig, tmp_path)
    rig = external(make_rig)
    with cameras(rig.stack.endpoint, tmp_path, *folders(tmp_path)) as first:  # before there is a router
        rig.start_all()
        rig.wait_ready()
        first.send_signal(signal.SIGTERM)
        assert first.wait(2.0) == 0
    arrived = threading.Event()

    def positions(received: Received[JointPositions]) -> None:
        del received
        arrived.set()

    with cameras(rig.stack.endpoint, tmp_path, *folders(tmp_path)):
        rig.bus.subscriber(topics.JOINT_POSITIONS, on_message=positions)
        assert arrived.wait(15.0), "nothing is measured after the camera's return"
        rig.wait_ready()
