"""Recordings of the whole stack: killed recorders, vision without sim, the loop beside a recorder."""

import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from armsight import topics
from armsight.bus import Received
from armsight_operator.monitor import Monitor
from armsight_operator.recording.info import info_of
from armsight_operator.recording.reader import Recording
from armsight_operator.report import from_recording, measure, summary
from armsight_operator.report.run import Run
from armsight_operator.stack import Stack
from armsight_operator.stack.executables import find_executable
from rig import Rig, without_stages

INSTANTS = 60
START = "2024-05-01T12:00:00Z"


@pytest.fixture
def armsight() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts commands; those that still run at the end are killed."""
    started: list[subprocess.Popen[str]] = []

    def start(*words: str) -> subprocess.Popen[str]:
        command = [str(find_executable("router")), *words]
        started.append(subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


def positions_of(path: Path) -> dict[int, bytes]:
    entries = Recording(path).entries({topics.JOINT_POSITIONS.key})
    return dict(without_stages(entry.decode(topics.JOINT_POSITIONS.message)) for entry in entries)


def whole_instants(path: Path) -> set[int]:
    """Of which both frames were recorded: of the last one the end of the file may have taken one."""
    frames: dict[str, set[int]] = {"camera/1/image": set(), "camera/2/image": set()}
    for entry in Recording(path).entries(frames):
        frames[entry.key].add(entry.instant_ns)
    return frames["camera/1/image"] & frames["camera/2/image"]


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a recorder leaves that was killed in the middle of a run in lockstep, with the arm moving."""
    folder = tmp_path_factory.mktemp("killed")
    path = folder / "run.mcap"
    rig = Rig(Stack(out=folder, clock="lockstep", start_time=START, target="none", mode="test-2"))
    recorder: subprocess.Popen[str] | None = None
    try:
        rig.start("router")
        command = [str(find_executable("router")), "record", str(path), "--connect", rig.stack.endpoint]
        recorder = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert recorder.stdout is not None
        assert "records to" in recorder.stdout.readline()
        instants: set[bytes] = set()
        rig.bus.subscriber(topics.CLOCK, on_message=lambda r: instants.add(r.message.capture_time.SerializeToString()))
        for name in ("vision", "control"):
            rig.start(name)
        rig.wait_until(lambda: rig.heard_of("vision") and rig.heard_of("control"), 30, "vision and control are there")
        rig.start("sim")
        rig.wait_until(lambda: len(instants) > INSTANTS, 90, f"{INSTANTS} instants")
        rig.pause(2.5)
    finally:
        if recorder is not None:
            recorder.kill()
            recorder.communicate()
        rig.close()
    return path


def test_a_killed_recorder_leaves_everything_but_the_last_second(killed: Path) -> None:
    info = info_of(Recording(killed))
    assert not info.complete
    assert info.lost == 0
    frames = [info.keys[f"camera/{name}/image"].count for name in ("1", "2")]
    assert min(frames) >= INSTANTS
    # of what every instant has none is missing: the recorder was there before the first, and in lockstep frames wait
    assert abs(frames[0] - frames[1]) <= 1
    assert abs(info.keys["joints/positions"].count - frames[0]) <= 2
    assert abs(info.keys["joints/command"].count - frames[0]) <= 2
    assert {"description", "camera/1/pose", "safety/stop", "health/vision"} <= set(info.keys)


def test_a_fresh_vision_measures_the_same_from_a_recording_bit_by_bit(
    killed: Path, make_rig: Callable[..., Rig], armsight: Callable[..., subprocess.Popen[str]]
) -> None:
    recorded = positions_of(killed)
    rig = make_rig()
    rig.start("router")
    rig.start("vision")
    measured: dict[int, bytes] = {}

    def keep(received: Received[Any]) -> None:
        stamp, content = without_stages(received.message)
        measured[stamp] = content

    rig.bus.subscriber(topics.JOINT_POSITIONS, keep=1000, on_message=keep)
    replay = armsight("replay", str(killed), "--lockstep", "--connect", rig.stack.endpoint)
    out, err = replay.communicate(timeout=120)
    assert replay.returncode == 0, err
    assert "camera/1/image" in out
    assert "joints/" not in out, "only what sim says to vision is replayed"
    both = sorted(set(recorded) & set(measured) & whole_instants(killed))
    assert len(both) >= INSTANTS
    assert len(set(recorded.values())) > INSTANTS // 2, "did the arm move?"
    assert [measured[stamp] for stamp in both] == [recorded[stamp] for stamp in both]


def test_report_from_a_recording_has_the_figures_of_the_live_one(
    make_rig: Callable[..., Rig], armsight: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    rig = make_rig(clock="lockstep", target="none", mode="hold")
    rig.start("router")
    recorder = armsight("record", str(path), "--without", "camera/*/image", "--connect", rig.stack.endpoint)
    assert recorder.stdout is not None
    assert "records to" in recorder.stdout.readline()
    rig.start_all()
    rig.wait_ready()
    run = Run(rig.bus, Monitor(rig.bus))
    live = measure.part1(run, 8.0, 2.0, lambda _: None)
    rig.mode("hold")
    recorder.send_signal(signal.SIGTERM)
    out, err = recorder.communicate(timeout=20)
    assert recorder.returncode == 0, err
    assert "lost none" in out
    instants = from_recording.instants_of(Recording(path), "test-1")[: len(live.time_s)]
    recorded = measure.part_of("test-1", instants, run.arm, len(run.cameras), 8.0)
    assert len(live.time_s) == 60
    assert summary.part_figures(recorded) == summary.part_figures(live)
    assert [instant.latency_ms for instant in instants] == run.latencies_ms
    # and the command reads the same motion
    motion = next(m for m in from_recording.measure(Recording(path)).motions if m.mode == "test-1")
    assert motion.part is not None
    assert (motion.part.estimated[: len(live.time_s)] == live.estimated).all()


def test_nothing_is_replayed_where_sim_is(
    killed: Path, running: Rig, armsight: Callable[..., subprocess.Popen[str]]
) -> None:
    before = running.true_joints()
    replay = armsight("replay", str(killed), "--connect", running.stack.endpoint)
    _, err = replay.communicate(timeout=30)
    assert replay.returncode == 1
    assert "sim is on this bus" in err
    assert err.count("\n") == 1
    assert abs(running.true_joints() - before).max() < 1e-3


def test_the_arm_follows_while_a_recorder_meets_a_full_disk(tracking: Rig, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    code = (
        "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000)); "
        "from armsight_operator.cli.app import main; main()"
    )
    recorder = subprocess.Popen(
        [sys.executable, "-c", code, "record", str(path), "--connect", tracking.stack.endpoint],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        with tracking.recording_truth() as truth:
            _, err = recorder.communicate(timeout=60)
            tracking.pause(1.0)
    finally:
        recorder.kill()
        recorder.communicate()
    assert recorder.returncode == 1
    assert "can't go on writing" in err
    tracking.wait_ready()
    assert len(truth.times) > 20
    assert tracking.moving()
    info = info_of(Recording(path))
    assert info.messages > 100
    assert info.lost == 0
