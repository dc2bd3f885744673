"""Lockstep: the same start gives the same run, byte for byte."""

from collections.abc import Callable

from rig import Rig

START = "2024-05-01T12:00:00Z"
INSTANTS = 40


def record(make: Callable[..., Rig]) -> dict[str, list[bytes]]:
    rig = make(clock="lockstep", samples=0, start_time=START, target="none", mode="hold")
    rig.start_all()
    rig.wait_ready()
    rig.reset((0.4, 0.0, -0.6, 0.5))
    first = rig.mode_and_next_instant("test-2", start_s=3.0)
    return rig.collect(first, INSTANTS)


def test_two_runs_give_identical_positions_and_commands(make_rig: Callable[..., Rig]) -> None:
    first, second = record(make_rig), record(make_rig)
    for key in ("joints/positions", "joints/command", "joints/true"):
        assert len(first[key]) == INSTANTS, key
        assert first[key] == second[key], f"{key} differs between two runs"
