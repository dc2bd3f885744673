"""Lockstep: the same start gives the same run, byte for byte."""

from collections.abc import Callable

import pytest

from rig import Rig

pytestmark = pytest.mark.untimed

START = "2024-05-01T12:00:00Z"
INSTANTS = 60


def record(make: Callable[..., Rig]) -> dict[str, list[bytes]]:
    return make(clock="lockstep", start_time=START, target="none", mode="test-2").record_from_the_start(INSTANTS)


def test_two_runs_give_identical_positions_and_commands(make_rig: Callable[..., Rig]) -> None:
    first, second = record(make_rig), record(make_rig)
    for key in ("joints/positions", "joints/command", "joints/true"):
        assert len(first[key]) == INSTANTS, key
        assert len(set(first[key])) == INSTANTS, f"{key}: some instants are alike, did the arm move?"
        assert first[key] == second[key], f"{key} differs between two runs"
