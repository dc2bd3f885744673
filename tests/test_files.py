"""Measuring pictures in files, without a bus: the same answer as on it."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from google.protobuf.json_format import Parse
from PIL import Image

from armsight import topics
from armsight.bus import Received
from armsight.times import from_timestamp
from armsight.v1.joints_pb2 import MARKER_STATUS_LOST, JointPositions
from armsight_operator.picture import take_snapshot, write_snapshot
from armsight_operator.stack.executables import find_executable
from rig import Rig

POSE = (0.4, 0.0, 0.7, -0.5)


def measure(folder: Path, *flags: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [find_executable("vision"), *flags], cwd=folder, capture_output=True, text=True, timeout=60, check=False
    )


def test_files_give_what_the_bus_gave(make_rig: Callable[..., Rig], tmp_path: Path) -> None:
    rig = make_rig(mode="hold")
    rig.start_all()
    rig.wait_ready()
    rig.reset(POSE)
    on_bus: dict[int, JointPositions] = {}

    def keep(received: Received[JointPositions]) -> None:
        on_bus[from_timestamp(received.message.capture_time)] = received.message

    rig.bus.subscriber(topics.JOINT_POSITIONS, keep=1000, on_message=keep)
    rig.wait_until(lambda: len(on_bus) > 5, 20, "vision measures")
    snapshot = take_snapshot(rig.bus)
    rig.wait_until(lambda: snapshot.capture_ns in on_bus, 5, "vision measures the instant of the snapshot")
    pictures = write_snapshot(snapshot, tmp_path)

    images = [f"--image={name}={path}" for name, path in pictures.items()]
    done = measure(tmp_path, "--calibration", "calibration.json", *images, "--out", "found")
    assert done.returncode == 0, done.stderr
    measured = Parse(done.stdout, JointPositions())
    seen = 0
    for here, there in zip(measured.markers, on_bus[snapshot.capture_ns].markers, strict=True):
        assert here.name == there.name
        if len(there.observations) < 2:
            continue  # the bus remembers where it was, files do not
        seen += 1
        assert here.status == there.status != MARKER_STATUS_LOST
        for axis in ("x", "y", "z"):
            assert getattr(here.position, axis) == pytest.approx(getattr(there.position, axis), abs=1e-6)
    assert seen >= 3
    for name, path in pictures.items():
        before, after = Image.open(path), Image.open(tmp_path / "found" / f"{name}.png")
        assert before.size == after.size
        assert before.tobytes() != after.tobytes(), "nothing is drawn"


def test_files_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    Image.new("RGB", (64, 64)).save(tmp_path / "a.png")
    (tmp_path / "broken.json").write_text("{", encoding="utf-8")
    (tmp_path / "empty.json").write_text("{}", encoding="utf-8")
    (tmp_path / "unknown.json").write_text(json.dumps({"description": {"wheels": 4}}), encoding="utf-8")
    for flags, reason in (
        (("--calibration", "no.json", "--image", "1=a.png"), "no.json cannot be read"),
        (("--calibration", "broken.json", "--image", "1=a.png"), "broken.json is not JSON"),
        (("--calibration", "empty.json", "--image", "1=a.png"), 'empty.json: there is no "description"'),
        (("--calibration", "unknown.json", "--image", "1=a.png"), "wheels"),
        (("--calibration", "empty.json", "--image", "a.png"), "NAME=FILE"),
        (("--calibration", "empty.json"), "--image"),
        (("--image", "1=a.png"), "--calibration"),
    ):
        done = measure(tmp_path, *flags)
        assert done.returncode == 2, flags
        assert reason in done.stderr, done.stderr
        assert not done.stdout
        assert len(done.stderr.splitlines()) == 1
