"""Faults of processes while the arm tracks and a recorder writes: done, undone, and what they cost in time."""

import json
import os
import signal
import socket
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import IO

from armsight.v1.health_pb2 import HEALTH_STATUS_OK
from armsight_operator.recording.invariants import check, health_showed
from armsight_operator.recording.reader import Recording
from armsight_operator.recording.timeline import WANTED, State, Timeline, timeline_of
from armsight_operator.stack.executables import find_executable
from rig import MOVING_RAD_S, SERVICES, Rig

ALL = ("router", *SERVICES)

RESULTS = "ARMSIGHT_RECOVERY_RESULTS"
"""Environment variable: a file to which the suites add what they measured; nothing is written without it."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault that is over, in nanoseconds of the wall clock, which is the recorder's as well."""

    kind: str
    victims: tuple[str, ...]
    began_ns: int
    ended_ns: int
    """It was started again, or goes on."""
    ready_ns: int
    """From when the recovery counts: all that was started again says it is well; what goes on is so at once."""
    over_ns: int
    """The arm moved again by then."""


@dataclass(frozen=True, slots=True)
class Recovery:
    """What one fault cost."""

    fault: str
    victim: str
    start_up_s: float
    """Of what was started again; 0 of what goes on."""
    recovery_s: float
    """From ready until the arm moves."""


@contextmanager
def recording(rig: Rig, path: Path) -> Iterator[None]:
    """A recorder that writes all but pixels."""
    command = [str(find_executable("router")), "record", str(path), "--without", "camera/*/image"]
    command += ["--connect", rig.endpoint]
    with path.with_suffix(".log").open("w") as log:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
        try:
            assert _first_line(process.stdout).startswith("records to")
            yield
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=20)
            assert process.returncode == 0, path.with_suffix(".log").read_text()
        finally:
            process.kill()
            process.communicate()


def kill(rig: Rig, victims: Sequence[str], number: int) -> Fault:
    """Ends processes by a signal and starts them again; waits until the arm moves."""
    before = {name: rig.health(name).instance for name in victims if name != "router"}
    began_ns = time.time_ns()
    for name in victims:
        rig.stack.kill(name, number)
    for name in victims:
        rig.start(name)
    ended_ns = time.time_ns()
    rig.wait_until(lambda: all(_is_new(rig, name, old) for name, old in before.items()), 40, "they are well again")
    if not before:
        rig.wait_until(lambda: _listens(rig.stack.port), 20, "the router listens")
    ready_ns = time.time_ns()
    return _over(rig, signal.Signals(number).name, victims, began_ns, ended_ns, ready_ns)


def freeze(rig: Rig, victims: Sequence[str], seconds: float) -> Fault:
    """Stops processes for a while and lets them go on; waits until the arm moves."""
    began_ns = time.time_ns()
    pids = [_pid(rig, name) for name in victims]
    for pid in pids:
        os.killpg(pid, signal.SIGSTOP)
    try:
        rig.pause(seconds)
    finally:
        ended_ns = time.time_ns()
        for pid in pids:
            os.killpg(pid, signal.SIGCONT)
    return _over(rig, "SIGSTOP", victims, began_ns, ended_ns, ended_ns)


def passed(rig: Rig, kind: str, victims: Sequence[str], began_ns: int) -> Fault:
    """A fault of the network that has just ended; waits until the arm moves."""
    ended_ns = time.time_ns()
    return _over(rig, kind, victims, began_ns, ended_ns, ended_ns)


def _pid(rig: Rig, name: str) -> int:
    process = rig.stack.process(name)
    assert process is not None
    return process.pid


def _over(rig: Rig, kind: str, victims: Sequence[str], began_ns: int, ended_ns: int, ready_ns: int) -> Fault:
    rig.wait_until(lambda: rig.moved_since(ended_ns), 40, f"the arm moves after {kind} of {', '.join(victims)}")
    return Fault(kind, tuple(victims), began_ns, ended_ns, ready_ns, time.time_ns())


def _listens(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
    except OSError:
        return False
    return True


def _is_new(rig: Rig, name: str, old: str) -> bool:
    return rig.health(name).instance != old and rig.health(name).status == HEALTH_STATUS_OK


def judged(path: Path, done: Sequence[Fault]) -> tuple[Timeline, list[Recovery]]:
    """What was recorded, which breaks no promise, and what each fault cost, which is told."""
    recorded = timeline(path)
    recoveries = [recovery(recorded, fault) for fault in done]
    print(*recoveries, sep="\n")
    tell(recoveries)
    assert_no_violation(recorded)
    return recorded, recoveries


def timeline(path: Path) -> Timeline:
    """What was recorded."""
    return timeline_of(Recording(path).messages(WANTED))


def assert_no_violation(recorded: Timeline) -> None:
    found = check(recorded)
    assert found.instants > 30, "too few true angles were recorded"
    assert found.resets == 0
    assert found.violations == (), "\n".join(map(str, found.violations))


def assert_health_showed(recorded: Timeline, fault: Fault) -> None:
    shown = {name: health_showed(recorded, name, fault.began_ns, fault.over_ns) for name in SERVICES}
    # nobody has the router's: whoever loses it says so, and all fall silent while it stands still
    seen_by = SERVICES if "router" in fault.victims else fault.victims
    unseen = [name for name in seen_by if not shown[name]]
    assert unseen == [], f"health of {unseen} showed nothing of {fault}"


def assert_some_health_showed(recorded: Timeline, fault: Fault) -> None:
    """Of a fault of the network: who suffers from it may be at the other end."""
    shown = [name for name in SERVICES if health_showed(recorded, name, fault.began_ns, fault.over_ns)]
    assert shown, f"nobody's health showed anything of {fault}"


def recovery(recorded: Timeline, fault: Fault) -> Recovery:
    """By the recording: when the true angles first move by a command to frames that were sent after the fault.

    What was on its way before, and comes out when a frozen process goes on, does not count; nor does an arm that was
    never still, until then. 0 where that was before the services said that they were well.
    """
    fresh = [c for c in recorded.commands if c.goal is not None and c.frames_sent_ns >= fault.ended_ns]
    assert fresh, f"nothing was commanded after {fault}"
    moves_ns = next(
        (
            later.log_ns
            for earlier, later in pairwise(recorded.true)
            if later.log_ns >= fresh[0].log_ns
            and earlier.instant_ns >= fresh[0].answers_ns
            and _speed(earlier, later) > MOVING_RAD_S
        ),
        None,
    )
    assert moves_ns is not None, f"the arm never moved after {fault}"
    victim = fault.victims[0] if len(fault.victims) == 1 else "all"
    start_up_s, recovery_s = (fault.ready_ns - fault.ended_ns) / 1e9, max(0, moves_ns - fault.ready_ns) / 1e9
    return Recovery(fault.kind, victim, start_up_s, recovery_s)


def _speed(earlier: State, later: State) -> float:
    passed_ns = later.instant_ns - earlier.instant_ns
    return float(abs(later.angles - earlier.angles).max()) * 1e9 / passed_ns if passed_ns > 0 else 0.0


def tell(recoveries: Sequence[Recovery], environment: Mapping[str, str] = os.environ) -> None:
    """Adds to the file of results, where one is asked for."""
    if RESULTS not in environment:
        return
    path = Path(environment[RESULTS])
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    path.write_text(json.dumps(known + [asdict(each) for each in recoveries], indent=1) + "\n", encoding="utf-8")


def _first_line(stream: IO[str] | None) -> str:
    assert stream is not None
    return stream.readline()
