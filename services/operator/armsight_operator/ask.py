"""What a person asks of the arm, in one place for the command line and the page: modes, targets, stop and release."""

import math
from collections.abc import Mapping

from foxglove_schemas_protobuf.Point3InFrame_pb2 import Point3InFrame

from armsight import topics
from armsight.bus import Bus
from armsight.errors import ConfigError
from armsight.times import to_timestamp, wall_ns
from armsight.v1.control_pb2 import CONTROL_MODE_JOINTS, SetModeRequest
from armsight.v1.joints_pb2 import JointSetpoint
from armsight.v1.safety_pb2 import STOP_ACTION_RELEASE, STOP_ACTION_STOP, StopRequest, StopState
from armsight_operator.modes import MODES
from armsight_operator.monitor import MODE_PREFIX, mode_name

FRAMES = ("base", "world")

TARGET_PERIOD_S = 0.1
"""How often a target is published again while it holds: what is lost on the way is made up for."""

_ANSWER_S = 5.0


def ask_mode(bus: Bus, name: str | None, start_s: float = 0.0) -> str:
    """Sets a mode other than `joints`, or without a name only asks for it; returns the mode in force.

    Raises:
        ConfigError: there is no such mode, or it needs angles.
        RefusedError: control's own reason.
        NoReplyError: control does not answer.
    """
    if name is not None and name not in MODES:
        raise ConfigError(f"no mode {name!r}; there are {', '.join(MODES)}")
    if name == "joints":
        raise ConfigError("mode joints needs angles: use `armsight move`")
    request = SetModeRequest()
    if name is not None:
        request = SetModeRequest(mode=f"{MODE_PREFIX}{name.upper().replace('-', '_')}", start_s=start_s)
    mode = bus.query(topics.MODE, request, timeout_s=_ANSWER_S).mode
    return mode_name(mode) if mode else ""


def ask_joints(bus: Bus, angles: Mapping[str, float]) -> None:
    """Moves the joints to angles in rad, by name, and holds them.

    Raises:
        RefusedError: control's own reason.
        NoReplyError: control does not answer.
    """
    request = SetModeRequest(mode=CONTROL_MODE_JOINTS, joints=setpoints(angles))
    bus.query(topics.MODE, request, timeout_s=_ANSWER_S)


def setpoints(angles: Mapping[str, float]) -> list[JointSetpoint]:
    """Angles in rad as messages."""
    return [JointSetpoint(name=name, position_rad=angle) for name, angle in angles.items()]


def target_message(x: float, y: float, z: float, frame: str) -> Point3InFrame:
    """A point for the tip, in metres, of this moment.

    Raises:
        ConfigError: it is in no frame that control knows, or not finite.
    """
    if frame not in FRAMES:
        raise ConfigError(f"frame {frame!r} is neither base nor world")
    if not all(math.isfinite(value) for value in (x, y, z)):
        raise ConfigError("a target needs three finite numbers")
    message = Point3InFrame(timestamp=to_timestamp(wall_ns()), frame_id=frame)
    message.point.x, message.point.y, message.point.z = x, y, z
    return message


def ask_stop(bus: Bus, source: str, reason: str, timeout_s: float = _ANSWER_S) -> StopState:
    """Stops the arm: it decelerates and holds until the same source releases it.

    Raises:
        NoReplyError: sim does not answer: nobody knows whether the arm stops.
    """
    request = StopRequest(action=STOP_ACTION_STOP, source=source, reason=reason)
    return bus.query(topics.STOP, request, timeout_s=timeout_s).state


def ask_release(bus: Bus, source: str, timeout_s: float = _ANSWER_S) -> StopState:
    """Takes a source's stop back. Other sources that stopped the arm keep it stopped.

    Raises:
        NoReplyError: sim does not answer.
    """
    return bus.query(topics.RELEASE, StopRequest(action=STOP_ACTION_RELEASE, source=source), timeout_s=timeout_s).state


def stopped_by(state: StopState) -> tuple[str, ...]:
    """The sources that keep the arm stopped."""
    return tuple(source.name for source in state.sources if source.stopped)
