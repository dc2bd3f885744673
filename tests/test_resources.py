"""What a process needs of its machine runs out while the arm tracks: it holds or goes on, nothing dies, it recovers."""

import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest

import faults
from armsight.shared_memory import PLACE
from armsight_operator.stack import Stack
from armsight_operator.stack.executables import find_executable
from rig import SERVICES, Rig, started

SECONDS = 3.0
AGAIN_S = 2.0
"""The arm moves by then, from the moment that what ran out is there again."""

ROOM_MIB = 24
"""Of a /dev/shm that is the test's own: enough for the frames, and soon filled."""

FILLING = str(PLACE / "filling")

MAY_MOUNT = os.geteuid() == 0 and shutil.which("nsenter") is not None


class Elsewhere(Stack):
    """Processes with something before their command lines."""

    def __init__(self, before: Sequence[str], out: Path) -> None:
        self._before = list(before)
        super().__init__(out=out)

    def command(self, name: str) -> list[str]:
        return [*self._before, *super().command(name)]


def suffer(rig: Rig, path: Path, lack: AbstractContextManager[None]) -> None:
    """Setup, fault, recovery and invariants, once."""
    before = rig.instances()
    with faults.recording(rig, path):
        rig.wait_until(rig.moving, 20, "the arm moves")
        with lack:
            rig.pause(SECONDS)
        ended_ns = time.time_ns()
        rig.wait_until(lambda: rig.moved_since(ended_ns), AGAIN_S, "the arm moves again")
        rig.wait_ready()
    assert rig.instances() == before, "a service died of it"
    faults.assert_no_violation(faults.timeline(path))


def test_all_processors_are_busy_with_something_else(tracking: Rig, tmp_path: Path) -> None:
    suffer(tracking, tmp_path / "run.mcap", busy(2 * (os.cpu_count() or 1)))


@contextmanager
def busy(processes: int) -> Iterator[None]:
    running = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
        for process in running:
            process.wait()


def test_no_process_can_open_another_file_or_connection(tracking: Rig, tmp_path: Path) -> None:
    suffer(tracking, tmp_path / "run.mcap", descriptors_exhausted(tracking))


@contextmanager
def descriptors_exhausted(rig: Rig) -> Iterator[None]:
    """Nobody may have more than are open now; meanwhile somebody wants to connect all the time."""
    limits = {}
    for name in ("router", *SERVICES):
        process = rig.stack.process(name)
        assert process is not None
        open_now = len(list(Path(f"/proc/{process.pid}/fd").iterdir()))
        limits[process.pid] = resource.prlimit(process.pid, resource.RLIMIT_NOFILE)
        resource.prlimit(process.pid, resource.RLIMIT_NOFILE, (open_now, limits[process.pid][1]))
    try:
        command = [str(find_executable("router")), "status", "--connect", rig.stack.endpoint]
        refused = subprocess.run(command, capture_output=True, timeout=30, check=False)
        assert refused.returncode != 0, "somebody was let in: nothing was exhausted"
        yield
    finally:
        for pid, limit in limits.items():
            resource.prlimit(pid, resource.RLIMIT_NOFILE, limit)


def test_next_to_nothing_may_be_locked_in_memory(tmp_path: Path) -> None:
    before = ["prlimit", "--memlock=65536:65536"]
    if os.geteuid() == 0:  # who has the capability may lock what it likes
        before += ["setpriv", "--bounding-set=-ipc_lock", "--inh-caps=-ipc_lock"]
    with started(Elsewhere(before, tmp_path / "stack")) as rig:
        rig.wait_until(rig.moving, 20, "the arm moves")
        assert rig.counters("vision").get("frames_by_shared_memory", 0) == 0
        for name in SERVICES[:2]:
            assert "ulimit -l" in rig.stack.log_file(name).read_text(encoding="utf-8")


@pytest.mark.skipif(not MAY_MOUNT and "ARMSIGHT_CI" not in os.environ, reason="has its own /dev/shm: needs root")
def test_dev_shm_is_full(tmp_path: Path) -> None:
    with own_dev_shm() as pid, started(Elsewhere(within(pid), tmp_path / "stack")) as rig:
        rig.wait_until(lambda: rig.counters("vision").get("frames_by_shared_memory", 0) > 30, 20, "frames go by it")
        suffer(rig, tmp_path / "run.mcap", filled(pid))
        # and whoever starts while it is full goes without
        with filled(pid):
            rig.kill("vision")
            rig.start("vision")
            rig.wait_ready()
            rig.wait_until(rig.moving, 20, "the arm moves")
            assert rig.counters("vision").get("frames_by_shared_memory", 0) == 0


def within(pid: int) -> list[str]:
    return ["nsenter", "--mount", "--target", str(pid), "--"]


@contextmanager
def own_dev_shm() -> Iterator[int]:
    """A process whose /dev/shm is small and of nobody else."""
    mount = f"mount -t tmpfs -o size={ROOM_MIB}m tmpfs /dev/shm && echo ready && exec sleep infinity"
    command = ["unshare", "--mount", "sh", "-c", mount]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "ready\n"
            yield process.pid
        finally:
            process.kill()


@contextmanager
def filled(pid: int) -> Iterator[None]:
    """Until not a byte is left in it."""
    fill = [*within(pid), "dd", "if=/dev/zero", f"of={FILLING}", "bs=64k"]
    ended = subprocess.run(fill, capture_output=True, text=True, timeout=30, check=False)
    assert "No space left" in ended.stderr
    try:
        yield
    finally:
        subprocess.run([*within(pid), "rm", FILLING], timeout=10, check=True)
