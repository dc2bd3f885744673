import math
from collections.abc import Callable

import numpy as np
import pytest

from armsight_control import safety
from armsight_control.bodies import Seen
from armsight_control.chain import Array
from armsight_control.correction import MOST_M, corrected
from armsight_control.description import Arm
from armsight_control.errors import PositionsError
from armsight_control.standoff import BEFORE, BEYOND, DISTANCE_M, beside, side_of
from armsight_control.tracking import Moving
from armsight_control.trajectory import MotionLimits

DT_S = 1 / 30
LIMITS = MotionLimits()
REST = safety.Pace(np.zeros(4), 0.0)


def test_the_last_word_passes_what_keeps_every_limit_and_refuses_what_breaks_one(arm: Arm) -> None:
    before = np.array([0.0, 1.5, 0.0, 0.0])
    step = 0.5 * LIMITS.acceleration_rad_s2 * DT_S**2
    pace = safety.check_setpoint(arm.chain, LIMITS, before, REST, before + np.array([step, 0, 0, 0]), DT_S)
    np.testing.assert_allclose(pace.velocity, [step / DT_S, 0, 0, 0])
    cruising = safety.Pace(np.array([1.4, 0, 0, 0]), DT_S)
    for text, pace, setpoint in (
        ("not finite", REST, np.array([math.nan, 0, 0, 0])),
        ("outside of the limits", REST, np.array([0, 1.58, 0, 0])),
        ("speed allows", cruising, before + np.array([1.6 * DT_S, 0, 0, 0])),
        ("needs more than 6 rad/s²", REST, before + np.array([1.1 * step, 0, 0, 0])),
        ("needs more than 6 rad/s²", cruising, before),
    ):
        with pytest.raises(safety.UnsafeError, match=text):
            safety.check_setpoint(arm.chain, LIMITS, before, pace, setpoint, DT_S)


def test_a_tip_that_jumps_is_refused_twice_and_then_believed() -> None:
    def at(x: float) -> Seen:
        return Seen(np.array([x, 0.0, 8.0]), 0.005)

    commanded = np.array([3.0, 0.0, 8.0])
    expected = safety.expect(None, at(3.0), commanded)
    expected = safety.expect(expected, at(3.02), commanded + np.array([0.03, 0, 0]))
    safety.check_expected(expected)
    for _ in range(2):
        expected = safety.expect(expected, at(4.5), commanded)
        with pytest.raises(PositionsError, match="the tip jumped"):
            safety.check_expected(expected)
    safety.check_expected(safety.expect(expected, at(4.5), commanded))
    safety.check_expected(safety.expect(expected, at(3.02), commanded))


def test_into_a_singularity_it_slows_down_and_out_of_it_not() -> None:
    shares = [safety.slow_for_singularity(present, lambda: 0.0) for present in (2.0, 0.5, 0.3, 0.1, 0.05)]
    assert shares == sorted(shares, reverse=True)
    assert (shares[0], shares[1]) == (1.0, 1.0)
    assert shares[-1] == pytest.approx(0.3)
    assert safety.slow_for_singularity(0.05, lambda: 0.4) == 1.0


def test_the_correction_takes_what_is_seen_steadily_and_nothing_else() -> None:
    commanded, wrong = np.array([3.0, 1.0, 7.0]), np.array([0.04, -0.03, 0.02])
    good, offset = Seen(commanded + wrong, 0.005), np.zeros(3)
    for _ in range(60):
        offset = corrected(offset, good, commanded, 0.5, DT_S)
    np.testing.assert_allclose(offset, wrong, atol=1e-3)
    for seen, speed in (
        (None, 0.0),
        (Seen(commanded, 0.1), 0.0),  # vague
        (Seen(commanded, 0.005), 3.0),  # fast
        (Seen(commanded + np.array([1.0, 0, 0]), 0.005), 0.0),  # blocked
    ):
        assert corrected(offset, seen, commanded, speed, DT_S) is offset
    for _ in range(300):
        offset = corrected(offset, Seen(commanded + np.array([0.2, 0.2, 0]), 0.005), commanded, 0.0, DT_S)
    assert np.linalg.norm(offset) == pytest.approx(MOST_M)


def test_the_place_beside_a_sphere_is_a_metre_off_on_the_line_to_the_shoulder() -> None:
    shoulder, centre = np.array([0.0, 0.0, 4.0]), np.array([2.0, 2.0, 5.0])
    velocity = np.array([0.3, -0.1, 0.2])
    for side in (BEFORE, BEYOND):
        found = beside(Moving(centre, velocity), shoulder, DISTANCE_M, side)
        assert np.linalg.norm(found.position - shoulder) == pytest.approx(3.0 + side)
        assert np.linalg.norm(found.position - centre) == pytest.approx(1.0)
        later = beside(Moving(centre + 1e-3 * velocity, velocity), shoulder, DISTANCE_M, side).position
        np.testing.assert_allclose(found.velocity, (later - found.position) / 1e-3, atol=1e-2)


def test_the_side_is_kept_as_long_as_it_is_reached_and_else_the_nearer_one_is_taken() -> None:
    shoulder, centre = np.array([0.0, 0.0, 4.0]), np.array([0.0, 3.0, 4.0])

    def folds_to(least_m: float) -> Callable[[Array], float]:
        return lambda point: max(0.0, least_m - float(np.linalg.norm(point - shoulder)))

    assert side_of(centre, shoulder, DISTANCE_M, None, folds_to(1.0)) == BEFORE
    assert side_of(centre, shoulder, DISTANCE_M, None, folds_to(3.0)) == BEYOND
    assert side_of(centre, shoulder, DISTANCE_M, BEYOND, folds_to(1.0)) == BEYOND
    assert side_of(centre, shoulder, DISTANCE_M, None, folds_to(4.5)) == BEYOND
    assert side_of(centre, shoulder, DISTANCE_M, BEFORE, lambda _: 1.0) == BEFORE, (
        "no to and fro between two that are as far"
    )
