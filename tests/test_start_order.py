"""Services come up in any order and find each other."""

import numpy as np
import pytest

from rig import Rig

ORDERS = [
    ("router", "sim", "vision", "control"),
    ("control", "vision", "sim", "router"),
    ("vision", "router", "control", "sim"),
]


@pytest.mark.parametrize("order", ORDERS, ids=lambda order: " ".join(order))
def test_loop_runs_whatever_the_order_of_start(empty: Rig, order: tuple[str, ...]) -> None:
    for name in order:
        empty.start(name)
        empty.pause(0.7)
    empty.wait_ready()
    empty.mode("joints", (0.3, 0.0, 0.4, 0.2))
    empty.wait_until(
        lambda: np.abs(empty.true_joints() - (0.3, 0.0, 0.4, 0.2)).max() < 0.005, 15, "the goal is reached"
    )


def test_every_service_ends_within_two_seconds_of_sigterm(empty: Rig) -> None:
    for name in ("router", "sim", "vision", "control"):
        empty.start(name)
    empty.wait_ready()
    for name in ("control", "vision", "sim", "router"):
        assert empty.seconds_to_stop(name) < 2.0


def test_every_service_ends_within_two_seconds_of_sigterm_without_a_router(empty: Rig) -> None:
    for name in ("sim", "vision", "control"):
        empty.start(name)
    empty.pause(6.0)
    for name in ("control", "vision", "sim"):
        assert empty.seconds_to_stop(name) < 2.0
