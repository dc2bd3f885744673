import math
from collections.abc import Callable

import numpy as np
import pytest
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from armsight_control.description import Arm
from armsight_control.errors import SetpointError
from armsight_control.setpoints import Setpoints, configuration, setpoint_of

STEP_NS = 33_333_333


def test_nothing_is_in_force_before_sim_accepted_something() -> None:
    assert Setpoints().in_force(0) is None


def test_motion_goes_on_from_what_was_sent_while_sim_follows() -> None:
    setpoints = Setpoints()
    assert setpoints.accept(np.zeros(1))
    for k in range(20):
        setpoints.command(k * STEP_NS, np.array([0.1 * (k + 1)]))
        if k > 0:  # confirmed one instant late, in order
            assert not setpoints.accept(np.array([0.1 * k]))
        in_force = setpoints.in_force((k + 1) * STEP_NS)
        assert in_force is not None
        np.testing.assert_allclose(in_force, 0.1 * (k + 1))


def test_a_reset_puts_what_sim_says_in_force() -> None:
    setpoints = Setpoints()
    setpoints.accept(np.zeros(1))
    setpoints.command(STEP_NS, np.array([0.1]))
    assert setpoints.accept(np.array([2.0]))
    np.testing.assert_array_equal(setpoints.in_force(2 * STEP_NS), [2.0])


def test_the_same_accepted_setpoint_again_changes_nothing() -> None:
    setpoints = Setpoints()
    setpoints.accept(np.zeros(1))
    setpoints.command(STEP_NS, np.array([0.1]))
    assert not setpoints.accept(np.zeros(1))
    np.testing.assert_array_equal(setpoints.in_force(2 * STEP_NS), [0.1])


def test_commands_that_sim_never_accepts_do_not_run_ahead() -> None:
    setpoints = Setpoints()
    setpoints.accept(np.zeros(1))
    for k in range(30):
        before = setpoints.in_force(k * STEP_NS)
        assert before is not None
        setpoints.command(k * STEP_NS, before + 0.1)
        assert before[0] < 1.2


def test_after_a_pause_what_sim_says_counts_alone() -> None:
    setpoints = Setpoints()
    setpoints.accept(np.zeros(1))
    setpoints.command(STEP_NS, np.array([0.1]))
    np.testing.assert_array_equal(setpoints.in_force(30 * STEP_NS), [0.0])


def test_an_accepted_setpoint_must_name_every_joint_once_within_its_limits(
    arm: Arm, states: Callable[..., JointStates]
) -> None:
    np.testing.assert_array_equal(setpoint_of(states([0, 0.1, 0.2, 0.3]), arm.chain), [0, 0.1, 0.2, 0.3])
    np.testing.assert_array_equal(setpoint_of(states([math.pi + 1e-4, 0, 0, 0]), arm.chain), [math.pi, 0, 0, 0])
    for broken in ([math.nan, 0, 0, 0], [0, 0, 0, math.inf], [0, 2.0, 0, 0]):
        with pytest.raises(SetpointError, match="outside of its limits"):
            setpoint_of(states(broken), arm.chain)
    message = states([0, 0, 0, 0])
    del message.joints[2]
    with pytest.raises(SetpointError, match="this arm needs joint1, joint2, joint3, joint4"):
        setpoint_of(message, arm.chain)


def test_a_configuration_a_hair_beyond_a_limit_is_clamped_and_further_is_refused(arm: Arm) -> None:
    given = {"joint1": 0.0, "joint2": math.pi / 2 + 5e-7, "joint3": 0.0, "joint4": 0.0}
    assert configuration(given, arm.chain)[1] == math.pi / 2
    with pytest.raises(SetpointError, match="joint2"):
        configuration(given | {"joint2": math.pi / 2 + 2e-6}, arm.chain)


def test_how_long_commands_take_is_learnt_from_when_they_are_in_force() -> None:
    setpoints = Setpoints()
    setpoints.accept(np.zeros(1), 0)
    assert setpoints.lead_s == pytest.approx(1 / 30)
    for k in range(1, 20):
        setpoints.command(k * STEP_NS, np.array([0.1 * k]))
        if k > 1:  # in force in the second frame after the one that was answered
            setpoints.accept(np.array([0.1 * (k - 1)]), (k + 1) * STEP_NS)
    assert setpoints.lead_s == pytest.approx(2 / 30, rel=1e-3)
