from armsight_operator.stack import Backoff


def lives(backoff: Backoff, lived_s: float, count: int) -> list[float]:
    delays: list[float] = []
    for _ in range(count):
        delays.append(backoff.delay(delays[-1] if delays else None, lived_s))
    return delays


def test_delays_double_from_half_a_second_up_to_ten() -> None:
    assert lives(Backoff(), lived_s=0.1, count=7) == [0.5, 1.0, 2.0, 4.0, 8.0, 10.0, 10.0]


def test_a_life_of_thirty_seconds_is_forgiven() -> None:
    assert Backoff().delay(10.0, lived_s=30.0) == 0.5
    assert Backoff().delay(10.0, lived_s=29.9) == 10.0


def test_the_first_death_waits_least_however_short_the_life() -> None:
    assert Backoff().delay(None, lived_s=0.0) == 0.5
