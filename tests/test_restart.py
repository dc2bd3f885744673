"""One service dies while the arm moves: it holds, the service returns, motion goes on."""

import numpy as np
import pytest

from rig import Rig

# Far from its twin (ϑ ± π, −ν, −ϕ, −ψ): going there by mistake swings joint 1 by π.
TRACKED = (3.6, 0.8, 7.5)


@pytest.mark.parametrize("victim", ["vision", "control", "router"])
def test_killed_service_returns_and_motion_goes_on_without_the_twin(tracking: Rig, victim: str) -> None:
    # setup: the arm follows a moving target
    with tracking.recording_truth() as truth:
        tracking.wait_until(tracking.moving, 20, "the arm moves")
        # fault
        tracking.kill(victim)
        if victim != "router":
            tracking.wait_until(lambda: not tracking.moving(), 3, "the arm holds")
        # recovery
        tracking.start(victim)
        tracking.wait_ready()
        tracking.wait_until(tracking.moving, 20, "the arm moves again")
        tracking.pause(3.0)
    # invariant: no joint was ever faster than its limit, and joint 1 never left for the twin
    truth.assert_speed_below(5.0)
    assert np.ptp(truth.joint(0)) < 1.5


def test_killed_sim_returns_at_its_start_pose_and_motion_goes_on(tracking: Rig) -> None:
    tracking.wait_until(tracking.moving, 20, "the arm moves")
    tracking.kill("sim")
    tracking.wait_until(lambda: tracking.control_state() != "MOVING", 5, "control commands nothing without sim")
    tracking.start("sim")
    tracking.wait_ready()
    with tracking.recording_truth() as truth:
        tracking.wait_until(tracking.moving, 20, "the arm moves again")
        tracking.pause(3.0)
    truth.assert_speed_below(5.0)
    assert np.ptp(truth.joint(0)) < 2.0


def test_stop_outlives_a_restart_of_control_and_release_ends_it(tracking: Rig) -> None:
    tracking.wait_until(tracking.moving, 20, "the arm moves")
    tracking.stop_arm("test")
    tracking.wait_until(lambda: not tracking.moving(), 2, "the arm holds")
    tracking.kill("control")
    tracking.start("control")
    tracking.wait_ready()
    tracking.pause(2.0)
    assert not tracking.moving()
    tracking.release_arm("test")
    tracking.wait_until(tracking.moving, 20, "the arm moves again")
