import time
from collections.abc import Callable
from pathlib import Path

from armsight_operator.stack import Backoff, Death, Stack, Supervisor


def deaths(supervisor: Supervisor, count: int, timeout_s: float = 5.0) -> list[Death]:
    found: list[Death] = []
    deadline = time.monotonic() + timeout_s
    while len(found) < count:
        assert time.monotonic() < deadline, found
        found += supervisor.poll()
        time.sleep(0.005)
    return found


def until_running(stack: Stack, supervisor: Supervisor, name: str) -> None:
    deadline = time.monotonic() + 5.0
    while not stack.running(name):
        assert time.monotonic() < deadline
        supervisor.poll()
        time.sleep(0.005)


def wait_until_it_speaks(stack: Stack, name: str) -> None:
    deadline = time.monotonic() + 20.0
    while not stack.log_file(name).read_bytes():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def test_a_killed_service_is_reported_once_and_started_again(stack: Stack) -> None:
    supervisor = Supervisor(stack, backoff=Backoff(first_s=0.05))
    stack.start_all()
    assert supervisor.poll() == []
    stack.kill("vision")
    (death,) = deaths(supervisor, 1)
    assert (death.name, death.code, death.restart_in_s) == ("vision", -9, 0.05)
    assert "vision was killed by SIGKILL" in str(death)
    assert not stack.running("vision")
    until_running(stack, supervisor, "vision")
    assert supervisor.poll() == []


def test_a_service_that_keeps_dying_is_started_ever_more_slowly(stack: Stack, fake: Callable[..., Path]) -> None:
    fake("sim", "print('no GL here')\nsys.exit(7)\n")
    supervisor = Supervisor(stack, backoff=Backoff(first_s=0.02, longest_s=0.08))
    stack.start("sim")
    assert [death.restart_in_s for death in deaths(supervisor, 4)] == [0.02, 0.04, 0.08, 0.08]


def test_a_death_shows_the_last_line_of_the_log(stack: Stack, fake: Callable[..., Path]) -> None:
    fake("sim", "print('no GL here')\nsys.exit(7)\n")
    stack.start("sim")
    (death,) = deaths(Supervisor(stack), 1)
    assert str(death).startswith("sim ended with exit code 7 after ")
    assert str(death).endswith(": no GL here; starting it again in 0.5 s")


def test_a_bad_configuration_is_not_tried_again(stack: Stack, fake: Callable[..., Path]) -> None:
    fake("control", "print('no solver of that name')\nsys.exit(2)\n")
    supervisor = Supervisor(stack, backoff=Backoff(first_s=0.01))
    stack.start("control")
    (death,) = deaths(supervisor, 1)
    assert death.hopeless
    assert str(death).endswith("starting it again would not help")
    time.sleep(0.05)
    assert supervisor.poll() == []
    assert not stack.running("control")


def test_without_restart_the_dead_stay_down(stack: Stack) -> None:
    supervisor = Supervisor(stack, restart=False)
    stack.start("sim")
    stack.kill("sim")
    (death,) = deaths(supervisor, 1)
    assert str(death).endswith("it stays down")
    assert supervisor.poll() == []


def test_an_executable_that_vanished_is_waited_for(stack: Stack, fake: Callable[..., Path]) -> None:
    supervisor = Supervisor(stack, backoff=Backoff(first_s=0.02, longest_s=0.02))
    stack.start("sim")
    wait_until_it_speaks(stack, "sim")  # its interpreter has read it
    fake("sim").unlink()
    stack.kill("sim")
    deaths(supervisor, 1)
    time.sleep(0.05)
    supervisor.poll()
    assert not stack.running("sim")
    fake("sim")
    until_running(stack, supervisor, "sim")


def test_what_was_never_started_is_no_death(stack: Stack) -> None:
    assert Supervisor(stack).poll() == []
