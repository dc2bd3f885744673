import math

import numpy as np

from armsight_sim.targets import default_target, exercise_target, visible_sphere


def distance_to_shoulder(point: tuple[float, float, float]) -> float:
    return math.dist(point, (0, 0, 4.0))


def test_default_target_is_always_within_reach_of_the_tip() -> None:
    # with joint 2 at 0 the distance from the shoulder is that of psi alone: 4.252 to 6
    distances = [distance_to_shoulder(default_target(t)) for t in np.linspace(0, 20, 2000)]
    assert min(distances) > 4.26
    assert max(distances) < 5.99


def test_exercise_target_is_the_exercises_own() -> None:
    np.testing.assert_allclose(exercise_target(0), (3.0, 0.5, 4.5))
    np.testing.assert_allclose(
        exercise_target(7), (3 * math.cos(7 * math.pi / 20), 4.5, math.sin(7 * math.pi / 18) + 4.5)
    )


def test_visible_target_circles_where_the_exercise_has_it() -> None:
    np.testing.assert_allclose(visible_sphere(0), (3.0, 0.0, 7.0))
    np.testing.assert_allclose(visible_sphere(7.5), (0.5, 2.5, 8.0), atol=1e-12)
