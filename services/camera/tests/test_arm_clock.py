import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armsight.times import NS_PER_S
from armsight_camera.arm_clock import WINDOW_NS, ArmClock

MS = 1_000_000
PERIOD = 33 * MS
START = 1_700_000_000 * NS_PER_S


def test_unix_time_where_there_is_no_clock() -> None:
    assert ArmClock(START).capture_ns(5 * NS_PER_S) == START + 5 * NS_PER_S


@settings(deadline=None)
@given(st.lists(st.integers(0, 30 * MS), min_size=1, max_size=60), st.integers(-5, 5))
def test_error_is_the_least_delay_seen_lately(delays: list[int], ahead_s: int) -> None:
    offset, clock = START + ahead_s * NS_PER_S, ArmClock(START)
    for number, delay in enumerate(delays):
        clock.heard(offset + number * PERIOD, number * PERIOD + delay, PERIOD)
    now = (len(delays) - 1) * PERIOD + delays[-1]
    lately = [d for number, d in enumerate(delays) if number * PERIOD + d >= now - WINDOW_NS]
    assert clock.capture_ns(now) == now + offset - min(lately)


@pytest.mark.parametrize(("slipped", "messages"), [(60 * MS, 2), (20 * MS, 17)], ids=["at once", "within the window"])
def test_clock_that_falls_behind_is_followed(slipped: int, messages: int) -> None:
    clock = ArmClock(START)
    for number in range(30 + messages):
        late = slipped if number >= 30 else 0
        clock.heard(START + number * PERIOD, number * PERIOD + late, PERIOD)
    now = 60 * PERIOD + slipped
    assert clock.capture_ns(now) == START + now - slipped
    assert clock.changes == 1


def test_one_message_that_was_held_up_changes_nothing() -> None:
    clock = ArmClock(START)
    for number in range(30):
        clock.heard(START + number * PERIOD, number * PERIOD, PERIOD)
    clock.heard(START + 30 * PERIOD, 30 * PERIOD + 400 * MS, PERIOD)
    assert clock.capture_ns(31 * PERIOD) == START + 31 * PERIOD


def test_clock_that_begins_anew_is_followed_at_once() -> None:
    clock = ArmClock(START)
    clock.heard(START, 0, PERIOD)
    clock.heard(START - 3600 * NS_PER_S, PERIOD, PERIOD)
    assert clock.capture_ns(PERIOD) == START - 3600 * NS_PER_S
    assert clock.changes == 2


def test_time_goes_on_when_the_clock_is_gone() -> None:
    clock = ArmClock(0)
    clock.heard(START, 0, PERIOD)
    assert clock.capture_ns(3600 * NS_PER_S) == START + 3600 * NS_PER_S


def test_another_clock_is_told_of_once_it_is_in_force() -> None:
    """Who sends looks at `changes` before it asks for a time: else the first time would be of the clock before."""
    told: list[int] = []

    class Watched(ArmClock):
        def __setattr__(self, name: str, value: object) -> None:
            super().__setattr__(name, value)
            if name == "changes" and value:
                told.append(self.capture_ns(0))

    Watched(5 * NS_PER_S).heard(100 * NS_PER_S, 0, 0)
    assert told == [100 * NS_PER_S]
