"""What control is asked to do, checked when it is asked."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from armsight.v1.control_pb2 import (
    CONTROL_MODE_FOLLOW,
    CONTROL_MODE_HOLD,
    CONTROL_MODE_JOINTS,
    CONTROL_MODE_TEST_1,
    CONTROL_MODE_TEST_2,
    CONTROL_MODE_TEST_ALL,
    CONTROL_MODE_TRACK,
    ControlMode,
    SetModeRequest,
)
from armsight.v1.joints_pb2 import JointSetpoint
from armsight_control.chain import Array, Chain
from armsight_control.errors import ModeError, SetpointError
from armsight_control.kinematics import need_report
from armsight_control.setpoints import configuration

NAMES: dict[str, ControlMode] = {
    "hold": CONTROL_MODE_HOLD,
    "joints": CONTROL_MODE_JOINTS,
    "test-1": CONTROL_MODE_TEST_1,
    "test-2": CONTROL_MODE_TEST_2,
    "test-all": CONTROL_MODE_TEST_ALL,
    "track": CONTROL_MODE_TRACK,
    "follow": CONTROL_MODE_FOLLOW,
}

AIMING = (CONTROL_MODE_TRACK, CONTROL_MODE_FOLLOW)
"""Modes in which the tip has a target, and the solver finds the joints."""

INITIAL_NAMES = tuple(name for name in NAMES if name != "joints")
"""Those that need no more than their name."""

_MAX_START_S = 1e6


@dataclass(frozen=True, slots=True)
class Mode:
    """A mode with what belongs to it."""

    mode: ControlMode
    goal: Array | None = None
    """For `joints`."""
    start_s: float = 0.0
    """For the tests: where on their time axis to begin."""


def mode_of(request: SetModeRequest, chain: Chain | None) -> Mode:
    """Checks a request.

    Raises:
        ModeError: an unknown mode, or one that can't be taken now.
        SetpointError: joints that this arm can't take.
        UnsupportedArmError: a test of the report's arm, and this is another.
    """
    if request.mode not in NAMES.values():
        raise ModeError(f"no mode {request.mode}; there are {', '.join(NAMES)}")
    if not 0 <= request.start_s <= _MAX_START_S:
        raise ModeError(f"start_s {request.start_s:g} is not within 0 to {_MAX_START_S:g} s")
    if request.mode in (CONTROL_MODE_TEST_1, CONTROL_MODE_TEST_2) and chain is not None:
        name = "test-1" if request.mode == CONTROL_MODE_TEST_1 else "test-2"
        need_report(chain, f"the mode {name}", "test-all")
    if request.mode != CONTROL_MODE_JOINTS:
        return Mode(request.mode, start_s=request.start_s)
    if chain is None:
        raise ModeError("the arm's description has not arrived yet: is sim running?")
    return Mode(request.mode, goal=configuration_of(request.joints, chain))


def configuration_of(joints: Iterable[JointSetpoint], chain: Chain) -> Array:
    """The joints of a request, in the arm's order.

    Raises:
        SetpointError: not every joint of the arm once, not finite, or outside of the limits.
    """
    given: dict[str, float] = {}
    for joint in joints:
        if joint.name in given or not math.isfinite(joint.position_rad):
            raise SetpointError(f"{joint.name} is there twice, or its angle is not finite")
        given[joint.name] = joint.position_rad
    return configuration(given, chain)
