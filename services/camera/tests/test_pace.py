from armsight.times import NS_PER_S
from armsight_camera.pace import Pace

PERIOD = NS_PER_S // 10


def test_pictures_of_one_number_are_due_together_and_a_period_after_those_before() -> None:
    pace = Pace(2)
    first = [pace.due_ns(10, number, now) for number, now in ((0, 5), (1, 6), (2, 7))]
    second = [pace.due_ns(10, number, 8) for number in range(3)]
    assert first == second == [5, 5 + PERIOD, 5 + 2 * PERIOD]


def test_picture_that_comes_late_delays_the_rest_of_every_file() -> None:
    pace = Pace(2)
    pace.due_ns(10, 0, 0)
    late = 5 * PERIOD
    assert pace.due_ns(10, 1, late) == late
    assert pace.due_ns(10, 1, 0) == late
    assert pace.due_ns(10, 2, late) == late + PERIOD


def test_nothing_is_due_before_every_file_is_open() -> None:
    pace = Pace(2)
    pace.opened()
    assert not pace.begun.is_set()
    pace.opened()
    assert pace.begun.is_set()
