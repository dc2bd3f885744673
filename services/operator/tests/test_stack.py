import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from armsight.topics import SERVICES
from armsight_operator.errors import MissingExecutableError, OperatorError, PortInUseError
from armsight_operator.stack import NAMES, Stack, executables
from armsight_operator.stack.executables import find_executable

STUBBORN = (
    "import signal, time\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\nprint('deaf', flush=True)\ntime.sleep(60)\n"
)


def started(stack: Stack, name: str) -> str:
    """Waits until the fake has written its line."""
    deadline = time.monotonic() + 5.0
    while not (text := stack.log_file(name).read_text()):
        assert time.monotonic() < deadline, f"{name} said nothing"
        time.sleep(0.01)
    return text.strip()


def pid(stack: Stack, name: str) -> int:
    process = stack.process(name)
    assert process is not None
    return process.pid


def test_services_get_the_flags_of_the_stack(fake: Callable[..., Path], tmp_path: Path) -> None:
    del fake
    options = {"clock": "lockstep", "samples": 4, "start_time": "2024-05-01T12:00:00Z", "target": "none"}
    with Stack(out=tmp_path / "out", mode="hold", extra={"vision": ["--threads", "1"]}, **options) as stack:  # type: ignore[arg-type]
        stack.start_all()
        bus = f"--connect {stack.endpoint} --namespace robots/arm"
        assert started(stack, "router") == f"router --listen {stack.endpoint}"
        assert started(stack, "sim") == (
            "--clock lockstep --samples 4 --fps 30 --target none --start-time 2024-05-01T12:00:00Z " + bus
        )
        assert started(stack, "vision") == "--threads 1 " + bus
        assert started(stack, "control") == "--mode hold " + bus


def test_close_ends_everything(stack: Stack) -> None:
    stack.start_all()
    for name in NAMES:
        started(stack, name)
    begun = time.monotonic()
    stack.close()
    assert time.monotonic() - begun < 1.0
    assert not any(stack.running(name) for name in NAMES)


def test_a_service_deaf_to_sigterm_is_killed_within_two_seconds(stack: Stack, fake: Callable[..., Path]) -> None:
    fake("sim", STUBBORN)
    stack.start_all()
    for name in NAMES:
        started(stack, name)
    begun = time.monotonic()
    stack.close()
    assert time.monotonic() - begun < 2.0
    assert not stack.running("sim")


def test_kill_waits_until_the_process_is_gone(stack: Stack) -> None:
    stack.start("sim")
    first = pid(stack, "sim")
    stack.kill("sim", signal.SIGKILL)
    assert not Path(f"/proc/{first}").exists()
    stack.start("sim")
    assert stack.running("sim")
    assert pid(stack, "sim") != first


def test_a_service_that_runs_is_not_started_twice(stack: Stack) -> None:
    stack.start("control")
    first = pid(stack, "control")
    stack.start("control")
    assert pid(stack, "control") == first


def test_logs_of_several_lives_follow_each_other(stack: Stack) -> None:
    for _ in range(2):
        stack.start("vision")
        process = stack.process("vision")
        assert process is not None
        while not process.last_line():
            time.sleep(0.01)
        stack.kill("vision")
    assert len(stack.log_file("vision").read_text().splitlines()) == 2


def test_a_port_that_is_taken_is_said_clearly(fake: Callable[..., Path], tmp_path: Path) -> None:
    del fake
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with (
            Stack(port=port, out=tmp_path / "out") as stack,
            pytest.raises(PortInUseError, match=f"port {port}.*--port"),
        ):
            stack.start_all()


def test_what_is_missing_is_said_before_anything_starts(stack: Stack, scripts: Path) -> None:
    (scripts / "armsight-control").unlink()
    with pytest.raises(MissingExecutableError, match=r"control is not installed.*make setup"):
        stack.start_all()
    assert not any(stack.running(name) for name in NAMES)


def test_vision_is_looked_for_where_the_build_leaves_it(tmp_path: Path) -> None:
    with pytest.raises(MissingExecutableError, match="make setup"):
        find_executable("vision", {}, root=tmp_path)
    built = tmp_path / "build" / "vision"
    built.mkdir(parents=True)
    (built / "armsight-vision").write_text("#!/bin/sh\n")
    (built / "armsight-vision").chmod(0o755)
    assert find_executable("vision", {}, root=tmp_path) == built / "armsight-vision"


def test_a_wrong_override_is_named(tmp_path: Path) -> None:
    with pytest.raises(MissingExecutableError, match=executables.VISION_VARIABLE):
        find_executable("vision", {executables.VISION_VARIABLE: str(tmp_path / "nothing")})


def test_unknown_names_are_refused(stack: Stack) -> None:
    with pytest.raises(OperatorError, match="no process 'elbow'; there are router, sim, vision, control"):
        stack.start("elbow")


@pytest.mark.usefixtures("fake")
def test_nothing_outlives_a_stack_that_is_killed(scripts: Path, tmp_path: Path) -> None:
    pids = tmp_path / "pids"
    code = (
        "import pathlib, sys, time\n"
        f"sys.executable = {str(scripts / 'python')!r}\n"
        "from armsight_operator.stack import NAMES, Stack\n"
        f"stack = Stack(out=pathlib.Path({str(tmp_path / 'out')!r}))\n"
        "stack.start_all()\n"
        f"pathlib.Path({str(pids)!r}).write_text(' '.join(str(stack.process(n).pid) for n in NAMES) + '\\n')\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.base_prefix + "/bin/python3", "-c", code], env=os.environ | _path()) as parent:
        deadline = time.monotonic() + 10.0
        while not (pids.exists() and pids.read_text().endswith("\n")):
            assert time.monotonic() < deadline
            time.sleep(0.02)
        parent.kill()
    deadline = time.monotonic() + 3.0
    left = {int(pid) for pid in pids.read_text().split()}
    assert len(left) == len(SERVICES) + 1
    while left and time.monotonic() < deadline:
        left = {pid for pid in left if Path(f"/proc/{pid}").exists() and not _zombie(pid)}
    assert not left


def _zombie(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


def _path() -> dict[str, str]:
    return {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}


def test_a_calibration_file_is_sims(fake: Callable[..., Path], tmp_path: Path) -> None:
    del fake
    with Stack(out=tmp_path / "out", calibration=tmp_path / "calibration.json") as stack:
        stack.start("sim")
        assert f"--calibration {tmp_path / 'calibration.json'}" in started(stack, "sim")
