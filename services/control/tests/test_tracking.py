import math

import numpy as np
import pytest

from armsight_control.chain import Array
from armsight_control.tracking import FORESEEN_S, Track, observed, predicted

NS = 1_000_000_000
PERIOD_NS = 33_333_333


def circle(t: float) -> Array:
    return np.array([3.0 + 0.5 * math.cos(t), 1.2 * math.sin(t), 7.0])


def followed(count: int, sigma_m: float, rng: np.random.Generator) -> Track:
    track = None
    for k in range(count):
        point = circle(k * PERIOD_NS / NS) + rng.normal(0.0, sigma_m, 3)
        track = observed(track, k * PERIOD_NS, point, max(sigma_m, 1e-3))
    assert track is not None
    return track


@pytest.mark.parametrize(("sigma_m", "off_m", "off_m_s"), [(0.0, 1e-3, 0.02), (0.005, 0.01, 0.1)])
def test_a_smooth_target_is_foreseen_a_frame_ahead(
    sigma_m: float, off_m: float, off_m_s: float, rng: np.random.Generator
) -> None:
    track = followed(60, sigma_m, rng)
    ahead_ns = 60 * PERIOD_NS
    found = predicted(track, ahead_ns, 59 * PERIOD_NS)
    t = ahead_ns / NS
    np.testing.assert_allclose(found.position, circle(t), atol=off_m)
    np.testing.assert_allclose(found.velocity, (circle(t + 1e-6) - circle(t - 1e-6)) / 2e-6, atol=off_m_s)


def test_a_jump_is_another_target_and_no_velocity(rng: np.random.Generator) -> None:
    track = followed(30, 0.0, rng)
    assert not track.jumped
    there = np.array([-3.0, 2.0, 6.0])
    track = observed(track, 30 * PERIOD_NS, there, 1e-3)
    assert track.jumped
    found = predicted(track, 31 * PERIOD_NS, 30 * PERIOD_NS)
    np.testing.assert_array_equal(found.position, there)
    np.testing.assert_array_equal(found.velocity, np.zeros(3))


def test_the_same_point_again_is_no_jump_and_changes_nothing() -> None:
    track = observed(None, 0, circle(0.0), 1e-3)
    again = observed(track, 0, circle(0.0), 1e-3)
    assert not again.jumped
    np.testing.assert_array_equal(again.state, track.state)


def test_a_target_that_is_stamped_on_another_clock_or_fell_silent_rests(rng: np.random.Generator) -> None:
    track = followed(30, 0.0, rng)
    for now_ns in (track.stamp_ns + round((FORESEEN_S + 0.1) * NS), track.stamp_ns + 3600 * NS, 0):
        found = predicted(track, now_ns + PERIOD_NS, now_ns or track.stamp_ns - 3600 * NS)
        np.testing.assert_array_equal(found.position, track.state[0])
        assert not found.velocity.any()
