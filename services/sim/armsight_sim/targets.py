"""Moving targets: points as functions of simulated time."""

from collections.abc import Callable
from math import cos, pi, sin

Point = tuple[float, float, float]


def default_target(t: float) -> Point:
    """Base frame, metres; always reachable with joint 2 at 0. Period 20 s."""
    w = pi * t / 10
    return (3.6 + 0.5 * cos(w), 1.2 * sin(2 * w), 7.5 + 0.4 * sin(w))


def exercise_target(t: float) -> Point:
    """Base frame, metres: the exercise's own, out of reach for most of its period."""
    return (3 * cos(pi * t / 20), 4 * sin(pi * t / 14) + 0.5, sin(pi * t / 18) + 4.5)


def visible_sphere(t: float) -> Point:
    """World frame, metres: centre of the orange sphere of radius 0.4."""
    w = pi * t / 15
    return (0.5 + 2.5 * cos(w), 2.5 * sin(w), 7 + sin(w))


def visible_box(t: float) -> Point:
    """World frame, metres: centre of the orange box beside that sphere."""
    w = pi * t / 15
    return (2 + 2 * cos(w), 2.5 + 1.5 * sin(w), 7.5)


NONE, VISIBLE = "none", "visible"

TARGETS: dict[str, tuple[str, Callable[[float], Point]]] = {
    "default": ("base", default_target),
    "exercise": ("base", exercise_target),
    VISIBLE: ("world", visible_sphere),
}
"""By name: the frame and the point."""
