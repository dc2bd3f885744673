import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from armsight_operator.stack.process import Process


def python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def wait_for(path: Path, timeout_s: float = 5.0) -> str:
    deadline = time.monotonic() + timeout_s
    while not (path.exists() and path.read_text().endswith("\n")):
        assert time.monotonic() < deadline, f"nothing in {path}"
        time.sleep(0.01)
    return path.read_text()


def gone(pid: int, timeout_s: float = 3.0) -> bool:
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
        except (FileNotFoundError, ProcessLookupError):
            return True
        if state == "Z":
            return True
        time.sleep(0.01)
    return False


def test_output_goes_to_the_log_and_the_exit_code_is_told(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_text("an earlier life\n")
    process = Process(python("import sys; print('out'); print('bad', file=sys.stderr); sys.exit(3)"), log)
    assert process.wait(5.0)
    assert process.poll() == 3
    assert log.read_text().startswith("an earlier life\n")
    assert set(log.read_text().split("\n")) >= {"out", "bad"}


def test_the_last_line_is_of_this_life_only(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_text("an earlier life\n")
    silent, talking = Process(python("pass"), log), Process(python("print('first\\nlast\\n')"), tmp_path / "other")
    assert silent.wait(5.0)
    assert talking.wait(5.0)
    assert silent.last_line() == ""
    assert talking.last_line() == "last"


def test_a_signal_that_killed_it_is_told_as_a_negative_code(tmp_path: Path) -> None:
    process = Process(["sleep", "60"], tmp_path / "log")
    process.send(signal.SIGTERM)
    assert process.wait(5.0)
    assert process.poll() == -signal.SIGTERM


def test_kill_takes_its_children_along(tmp_path: Path) -> None:
    log = tmp_path / "log"
    process = Process(["sh", "-c", "sleep 60 & echo $!; wait"], log)
    child = int(wait_for(log))
    process.kill()
    assert gone(child)


def test_children_of_a_process_that_died_alone_are_killed_too(tmp_path: Path) -> None:
    log = tmp_path / "log"
    process = Process(["sh", "-c", "sleep 60 & echo $!; wait"], log)
    child = int(wait_for(log))
    os.kill(process.pid, signal.SIGKILL)
    assert process.wait(5.0)
    assert gone(child)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM], ids=lambda number: number.name)
def test_it_does_not_outlive_whoever_started_it(tmp_path: Path, number: signal.Signals) -> None:
    log, pid_file = tmp_path / "log", tmp_path / "pid"
    code = (
        "import pathlib, sys, time\n"
        "from armsight_operator.stack.process import Process\n"
        f"process = Process(['sleep', '60'], pathlib.Path({str(log)!r}))\n"
        f"pathlib.Path({str(pid_file)!r}).write_text(f'{{process.pid}}\\n')\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen(python(code)) as parent:
        pid = int(wait_for(pid_file))
        parent.send_signal(number)
    assert gone(pid)
