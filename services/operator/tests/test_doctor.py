"""Every check finds what is right and what is wrong; the command ends as it says."""

import importlib.metadata
import importlib.util
import json
import os
import socket
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from test_cli import Command, command, saying

from armsight.session import SessionConfig
from armsight.shared_memory import LOCK_BYTES
from armsight_operator.cli import doctor as command_module
from armsight_operator.cli.app import main
from armsight_operator.doctor import Finding, Level, facts, machine, network, software
from armsight_operator.doctor.machine import ClockFacts, Holder
from armsight_operator.doctor.network import BusFacts, Heard
from armsight_operator.doctor.software import Answer
from armsight_operator.stack import free_port
from armsight_operator.stack.executables import VISION_VARIABLE
from fake_arm import FakeArm
from secure_bus import SecureBus

__all__ = ["command"]

EVEN = ClockFacts(wall_s=2e9, newest_file_s=1.9e9, wall_took_s=0.3, monotonic_took_s=0.3001, synchronised=True)
IN = BusFacts(("tcp/127.0.0.1:7447",), connected=True, refusal="")
HELPED = Answer(0, "Usage: armsight-vision")

OUTCOMES: list[tuple[Finding, Level, str]] = [
    (machine.memory_lock(True, None, 8_000_000), Level.OK, "no limit"),
    (machine.memory_lock(True, 64_000, 8_000_000), Level.OK, "8.0 MB are needed"),  # by a capability
    (machine.memory_lock(False, 64_000, 8_000_000), Level.WARNING, "ulimit -l 7813"),
    (machine.shared_memory(64_000_000, 6_000_000), Level.OK, "64 MB free"),
    (machine.shared_memory(5_000_000, 6_000_000), Level.BROKEN, "--shm-size"),
    (machine.shared_memory(None, 6_000_000), Level.WARNING, "ARMSIGHT_SHARED_MEMORY=off"),
    (machine.disk(5_000_000_000, "/here"), Level.OK, "5.0 GB free in /here"),
    (machine.disk(500_000_000, "/here"), Level.WARNING, "--out"),
    (machine.disk(50_000_000, "/here"), Level.BROKEN, "make room"),
    (machine.clock(EVEN), Level.OK, "synchronised"),
    (machine.clock(replace(EVEN, synchronised=None)), Level.OK, "can't be told"),
    (machine.clock(replace(EVEN, synchronised=False)), Level.WARNING, "chrony"),
    (machine.clock(replace(EVEN, wall_took_s=5.3)), Level.WARNING, "jumped by +5.00 s"),
    (machine.clock(replace(EVEN, wall_took_s=-1.0)), Level.WARNING, "jumped by -1.30 s"),
    (machine.clock(replace(EVEN, wall_s=1.8e9)), Level.BROKEN, "set the clock"),
    (machine.port(7447, "the router", "--port", None, ours=False), Level.OK, "free"),
    (machine.port(7447, "the router", "--port", Holder(7, "zenohd"), ours=True), Level.OK, "zenohd (pid 7)"),
    (machine.port(7447, "the router", "--port", Holder(7, "nginx"), ours=False), Level.WARNING, "nginx (pid 7)"),
    (machine.port(7447, "the router", "--port", Holder(None), ours=False), Level.WARNING, "another user"),
    (machine.docker("26.1", ""), Level.OK, "26.1"),
    (machine.docker("", "docker: No such file or directory"), Level.INFO, "No such file"),
    (software.python((3, 11, 0), "python"), Level.OK, "3.11.0"),
    (software.python((3, 10, 9), "python"), Level.BROKEN, "install Python 3.11"),
    (software.packages({"rich": "15.0.0"}, {"rich": "15.0.0", "more": "1"}), Level.OK, "all 1"),
    (software.packages({"torch": "2.6.0"}, {"torch": "2.6.0+cpu"}), Level.OK, "all 1"),
    (software.packages({"rich": "15.0.0"}, {"rich": "14.0.0"}), Level.WARNING, "rich 14.0.0 instead of 15.0.0"),
    (software.packages({"rich": "15.0.0"}, {}), Level.BROKEN, "not installed: rich"),
    (software.packages(dict.fromkeys("abcdefg", "1"), {}), Level.BROKEN, "a, b, c, d and 3 more"),
    (software.needed_packages([]), Level.OK, "all that"),
    (software.needed_packages(["rich missing"]), Level.BROKEN, "rich missing"),
    (software.zenoh("1.10.2", "1.10.2"), Level.OK, "1.10.2"),
    (software.zenoh("1.10.2", "1.9.0"), Level.WARNING, "1.9.0 in vision"),
    (software.zenoh("1.10.2", ""), Level.INFO, "no vision"),
    (software.zenoh("", "1.10.2"), Level.BROKEN, "not installed"),
    (software.vision("/v", "", HELPED, expected=True), Level.OK, "/v"),
    (software.vision("/v", "", Answer(127, "", "no libopencv.so\n"), expected=True), Level.BROKEN, "no libopencv.so"),
    (software.vision("/v", "", Answer(-11), expected=True), Level.BROKEN, "exit code -11"),
    (software.vision("", "there is no executable", None, expected=True), Level.BROKEN, "ARMSIGHT_VISION"),
    (software.vision("", "there is no executable", None, expected=False), Level.INFO, "not installed here"),
    (software.gl(Answer(0, "egl\n")), Level.OK, "by egl"),
    (software.gl(Answer(0, "osmesa\n")), Level.OK, "by osmesa"),
    (software.gl(Answer(1, "", "Traceback\nRenderError: does not draw")), Level.BROKEN, "RenderError: does not draw"),
    (software.gl(Answer(None)), Level.BROKEN, "did not end in time"),
    (software.gl(None), Level.INFO, "not installed here"),
    (software.solvers(Answer(0, "descent for 3 joints: \ndamped for 3 joints: \n")), Level.OK, "2 blocks"),
    (
        software.solvers(Answer(0, "a: \nb: this CPU lacks avx2\n")),
        Level.WARNING,
        "b not compiled: this CPU lacks avx2",
    ),
    (software.solvers(Answer(0, "")), Level.BROKEN, "names no solver"),
    (software.solvers(Answer(1, "", "ImportError: torch")), Level.BROKEN, "ImportError: torch"),
    (software.solvers(None), Level.INFO, "not installed here"),
    (network.router(IN), Level.OK, "tcp/127.0.0.1:7447"),
    (network.router(replace(IN, connected=False)), Level.WARNING, "armsight up"),
    (network.router(replace(IN, connected=False, refusal="our certificate has expired")), Level.BROKEN, "expired"),
]


@pytest.mark.parametrize(("finding", "level", "said"), OUTCOMES)
def test_a_check_finds_what_is_right_and_what_is_wrong(finding: Finding, level: Level, said: str) -> None:
    assert finding.level is level
    assert said in f"{finding.found}; {finding.mend}"
    assert bool(finding.mend) == (level is not Level.OK) or level is Level.INFO
    assert "\n" not in f"{finding.found}{finding.mend}"


def test_every_check_can_fail_and_can_be_well() -> None:
    levels: dict[str, set[Level]] = {}
    for finding, _, _ in OUTCOMES:
        levels.setdefault(finding.check, set()).add(finding.level)
    for name, seen in levels.items():
        assert Level.OK in seen, name
        assert len(seen) > 1, name


def test_services_are_told_with_what_to_do() -> None:
    told = network.services(
        replace(
            IN,
            services=(
                Heard("sim", "ok", "", "1"),
                Heard("vision", "missing", "not heard of", ""),
                Heard("control", "degraded", "sees nothing", "1"),
                Heard("recorder", "ok", "", "0"),
            ),
        ),
        "1",
    )
    assert [(one.check, one.level) for one in told] == [
        ("sim", Level.OK),
        ("vision", Level.WARNING),
        ("control", Level.WARNING),
        ("recorder", Level.WARNING),
    ]
    assert "armsight-vision" in told[1].mend
    assert "sees nothing" in told[2].found
    assert "version 0, here is 1" in told[3].found
    assert network.services(replace(IN, connected=False), "1") == []


def test_requirements_are_read_as_pip_writes_them() -> None:
    text = "# pinned\nrich==15.0.0\nTorch==2.6.0 ; python_version > '3'\n\nuvloop>=1\n"
    assert software.pinned_in(text) == {"rich": "15.0.0", "torch": "2.6.0"}


def test_who_listens_at_a_port_is_found() -> None:
    with socket.create_server(("127.0.0.1", 0)) as held:
        holder = facts.holder(held.getsockname()[1])
        assert holder is not None
        assert holder.pid == os.getpid()
    assert facts.holder(free_port()) is None


def test_another_program_is_not_waited_for_too_long_and_may_be_absent() -> None:
    assert facts.ask([sys.executable, "-S", "-c", "print(1)"], 20).out == "1\n"
    began = time.monotonic()
    slow = facts.ask([sys.executable, "-S", "-c", "import time; time.sleep(60)"], 0.5)
    assert (slow.code, time.monotonic() - began < 10) == (None, True)
    assert "No such file" in facts.ask(["/no/such/program"], 1).last_line


def test_zenoh_of_a_program_is_read_from_it(tmp_path: Path) -> None:
    program = tmp_path / "vision"
    program.write_bytes(b"\x7fELF\0/registry/zenoh-1.2.3/src/lib.rs\0")
    assert facts.zenoh_of(program) == "1.2.3"
    program.write_bytes(b"\x7fELF")
    assert facts.zenoh_of(program) == ""
    assert facts.zenoh_of(tmp_path / "nothing") == ""


def test_what_this_machine_says_of_itself_makes_sense(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert facts.installed()["eclipse-zenoh"] == facts.installed_version("eclipse-zenoh") != ""
    assert facts.installed_version("no-such-package") == ""
    assert facts.pinned(tmp_path) is None
    assert facts.free_disk(tmp_path) > 0
    assert facts.memory_lock()[2] == LOCK_BYTES
    assert machine.clock(facts.clock()).level is not Level.BROKEN
    monkeypatch.setattr(importlib.metadata, "requires", lambda _: ["rich>=999", "typer", "nothing; extra == 'x'"])
    assert [one.split()[0] for one in facts.unmet()] == ["rich"]


def test_simulator_and_solvers_are_asked_in_processes_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "armsight_sim" else object())
    monkeypatch.setattr(facts, "ask", lambda command, _: Answer(0, " ".join(command)))
    assert facts.graphics() is None
    answer = facts.compiled_solvers()
    assert answer is not None
    assert answer.out.startswith(sys.executable)


def test_whoever_is_on_the_bus_is_heard(endpoint: str, arm: FakeArm) -> None:
    def say() -> None:
        for name in ("sim", "vision", "control"):
            arm.say_health(name)

    with saying(say):
        told = facts.bus(SessionConfig(endpoints=(endpoint,), shared_memory="off"))
    assert told.connected
    assert [(one.name, one.status) for one in told.services] == [(n, "ok") for n in ("sim", "vision", "control")]


def test_a_router_that_is_not_there_and_one_that_wants_certificates_are_told_apart(tmp_path: Path) -> None:
    nowhere = facts.bus(SessionConfig(endpoints=(f"tcp/127.0.0.1:{free_port()}",), shared_memory="off"))
    assert (nowhere.connected, nowhere.refusal) == (False, "")
    secure = SecureBus(tmp_path)
    secure.start_router()
    try:
        bare = facts.bus(SessionConfig(endpoints=(secure.endpoint.replace("tls/", "tcp/"),), shared_memory="off"))
    finally:
        secure.close()
    assert not bare.connected
    assert "certificates" in bare.refusal


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Other programs are not started: these tests are of what is made of their answers."""
    monkeypatch.setattr(facts, "ask", lambda command, _: Answer(0, "x: \n" if command[0] == sys.executable else "1.0"))


@pytest.mark.usefixtures("quick", "arm")
def test_the_command_says_all_and_fails_where_something_is_broken(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(VISION_VARIABLE, sys.executable)  # built or not
    monkeypatch.setattr(command_module, "PORTS", {free_port(): "armsight metrics"})
    code, out, _ = command("doctor", "--json")
    told = json.loads(out)
    assert (code, told["ok"]) == (0, True), told
    checks = {one["check"]: one for one in told["checks"]}
    assert {"clock", "memory lock", "disk", "python", "packages", "zenoh", "vision", "router", "sim"} <= set(checks)
    assert checks["sim"]["level"] == "warning"  # nobody says its health: a warning is no failure
    monkeypatch.setattr(facts, "free_disk", lambda _: 0)
    code, out, _ = command("doctor")
    assert code == 1
    broken = [line for line in out.splitlines() if line.startswith("broken")]
    assert len(broken) == 1
    assert "disk" in broken[0]
    assert "make room" in broken[0]


def test_a_mistake_of_the_command_line_is_no_finding(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["doctor", "--connect", "nowhere"])
    assert ended.value.code == 2
    assert capsys.readouterr().out == ""


def test_the_operators_process_loads_neither_mujoco_nor_torch() -> None:
    code = (
        "import sys, armsight_operator.doctor, armsight_operator.doctor.examine, armsight_operator.cli.doctor; "
        "print([name for name in ('mujoco', 'torch', 'armsight_sim', 'armsight_control') if name in sys.modules])"
    )
    assert facts.ask([sys.executable, "-c", code], 60).out == "[]\n"
