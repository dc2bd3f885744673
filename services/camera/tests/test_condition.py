from pathlib import Path

import pytest

from armsight.v1.health_pb2 import HEALTH_STATUS_DEGRADED, HEALTH_STATUS_OK, HEALTH_STATUS_WAITING
from armsight_camera.condition import Condition, health_of
from armsight_camera.devices import Device, Kind

WALL = 1_700_000_000_000_000_000
SINCE = "2023-11-14 22:13:20Z"


@pytest.fixture
def pair() -> tuple[Condition, Condition]:
    """Both deliver."""
    made = tuple(Condition(Device(name, str(Path(f"/dev/video{name}")), Kind.DEVICE)) for name in ("1", "2"))
    for condition in made:
        condition.opened((), 0.0, WALL)
        condition.took(0.0, 0.0, WALL)
    return made[0], made[1]


def test_all_is_well_while_frames_come(pair: tuple[Condition, Condition]) -> None:
    assert health_of(pair, 1.0) == (HEALTH_STATUS_OK, "")


def test_lost_camera_is_told_of_since_when(pair: tuple[Condition, Condition]) -> None:
    assert pair[1].lost("it gives no more frames", WALL)
    assert not pair[1].lost("can't be opened", WALL + 10**10), "it was lost before"
    status, detail = health_of(pair, 1.0)
    assert status == HEALTH_STATUS_DEGRADED
    assert detail == f"camera 2 (/dev/video2) is gone since {SINCE}: can't be opened; it is tried again"


def test_camera_that_was_never_there_is_waited_for(pair: tuple[Condition, Condition]) -> None:
    absent = Condition(Device("3", "/dev/video3", Kind.DEVICE))
    absent.lost("can't be opened", WALL)
    assert health_of([absent], 1.0)[0] == HEALTH_STATUS_WAITING
    status, detail = health_of([*pair, absent], 1.0)
    assert status == HEALTH_STATUS_DEGRADED, "the others go on without it"
    assert detail.startswith("camera 3 (/dev/video3) is not there yet")


def test_silent_camera_is_told_of(pair: tuple[Condition, Condition]) -> None:
    pair[0].took(9.0, 9.0, WALL)
    status, detail = health_of(pair, 10.0)
    assert status == HEALTH_STATUS_DEGRADED
    assert detail == f"camera 2 (/dev/video2) is there, and gives no frames since {SINCE}"


def test_driver_that_did_not_take_a_setting_is_no_trouble_but_told_of(pair: tuple[Condition, Condition]) -> None:
    pair[0].opened(("exposure 120 (is 157)",), 0.0, WALL)
    assert health_of(pair, 1.0) == (
        HEALTH_STATUS_OK,
        "camera 1 (/dev/video1): its driver did not take exposure 120 (is 157)",
    )


def test_files_at_their_end_are_well(pair: tuple[Condition, Condition]) -> None:
    for condition in pair:
        condition.ended = True
    status, detail = health_of(pair, 1e6)
    assert status == HEALTH_STATUS_OK
    assert "all files were sent" in detail


def test_rate_is_that_of_the_times_of_frames(pair: tuple[Condition, Condition]) -> None:
    for number in range(1, 40):
        pair[0].took(number / 25, 0.0, WALL)
    assert pair[0].rate_hz() == pytest.approx(25)
