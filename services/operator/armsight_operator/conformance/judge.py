"""Judging what a service said, without a bus: messages in; what the contract does not allow is raised."""

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from armsight.times import NS_PER_S, from_timestamp
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.health_pb2 import HEALTH_STATUS_UNSPECIFIED, Health
from armsight.v1.joints_pb2 import JointCommand, StageTimes
from armsight.v1.parameters_pb2 import Parameter, ParameterValue
from armsight_operator.conformance.check import UnfulfilledError, require

Array = npt.NDArray[np.float64]

HEALTH_PERIOD_S = 1.0
_HEALTH_SLACK_S = 0.6
_ROUNDING_RAD = 1e-6
_CLOCKS_APART_S = 30.0
"""Wall clocks of two machines may differ by this much before an instant is taken for nonsense."""


def check_health(service: str, heard: Sequence[tuple[float, Health]], now_s: float) -> None:
    """Fields of a service's health, and how often it comes.

    Args:
        service: whose health it is.
        heard: in order, each with the monotonic time of its arrival, s.
        now_s: Unix time here.
    """
    require(len(heard) >= 2, f"{len(heard)} messages on health/{service} in 3 s", "one a second")
    for (before_s, _), (after_s, _) in pairwise(heard):
        seen = f"{after_s - before_s:.1f} s between two of them"
        require(after_s - before_s <= HEALTH_PERIOD_S + _HEALTH_SLACK_S, seen, "at most a second, and some delay")
    for _, health in heard:
        require(health.service == service, f"service {health.service!r}", f"{service!r}")
        require(health.status != HEALTH_STATUS_UNSPECIFIED, "no status", "WAITING, OK or DEGRADED")
        require(bool(health.instance), "no instance", "a text of this process alone")
        require(bool(health.version), "no version", "the service's version")
        started_s, said_s = from_timestamp(health.started) / NS_PER_S, from_timestamp(health.now) / NS_PER_S
        require(0 < started_s <= said_s, f"started at {started_s:.0f}, now {said_s:.0f}", "both set, in this order")
        off_s = abs(said_s - now_s)
        require(off_s < _CLOCKS_APART_S, f"now is {off_s:.0f} s off", "Unix time")
    instances = {health.instance for _, health in heard}
    seen = f"{len(instances)} instances in {len(heard)} messages"
    require(len(instances) == 1, seen, "one: does it restart, or does a second one run?")


def rose(before: Health, after: Health, words: tuple[str, ...]) -> int:
    """By how much the counters rose whose names contain one of the words."""

    def total(health: Health) -> int:
        return sum(count for name, count in health.counters.items() if any(word in name for word in words))

    return total(after) - total(before)


def beyond(parameter: Parameter) -> ParameterValue | None:
    """A value that this parameter must not take; nothing for a flag."""
    kind = parameter.value.WhichOneof("kind")
    if kind == "number":
        return ParameterValue(number=parameter.most + 1.0)
    if kind == "whole":
        return ParameterValue(whole=round(parameter.most) + 1)
    if kind == "text":
        return ParameterValue(text="conformance: none of the choices")
    return None


def check_parameter(parameter: Parameter) -> None:
    """A parameter is described, and its value is within its own bounds."""
    name, kind = parameter.name, parameter.value.WhichOneof("kind")
    require(bool(name), "a parameter without a name", "a name")
    require(bool(parameter.description), f"{name} without a description", "one line for a person")
    require(kind is not None, f"{name} without a value", "the value in force")
    if kind in ("number", "whole"):
        value = parameter.value.number if kind == "number" else parameter.value.whole
        seen = f"{name} = {value:g}, within {parameter.least:g} to {parameter.most:g}"
        require(parameter.least <= value <= parameter.most, seen, "a value within its bounds")
    elif kind == "text":
        seen = f"{name} = {parameter.value.text!r} of {list(parameter.choices)}"
        require(parameter.value.text in parameter.choices, seen, "one of its choices")


def check_stages(stages: StageTimes, *names: str) -> None:
    """Stamps of stages are set and in order."""
    times = [int(getattr(stages, f"{name}_ns")) for name in names]
    text = ", ".join(f"{name} {time}" for name, time in zip(names, times, strict=True))
    require(all(times), text, "all of them set")
    require(times == sorted(times), text, "in this order")


def check_answers(asked: Sequence[int], answered: Sequence[int]) -> None:
    """Every instant is answered once, in order, and nothing else is.

    Args:
        asked: capture times, Unix nanoseconds, in order.
        answered: those that the answers name, as they came.
    """
    never = sorted(set(asked) - set(answered))
    require(not never, f"{len(never)} of {len(asked)} instants were not answered", "an answer to each")
    unasked = [each for each in answered if each not in set(asked)]
    require(not unasked, f"{len(unasked)} answers for a capture time that nobody had", "the capture time of the frames")
    twice = len(answered) - len(set(answered))
    require(twice == 0, f"{twice} instants were answered twice", "one answer to each")
    require(list(answered) == sorted(answered), "answers out of order", "the order of the instants")


def check_command(
    command: JointCommand, names: Sequence[str], limits: Array, before: Array, step: Array
) -> Array | None:
    """A command is a hold, or complete, finite, within limits, and no farther than speed allows.

    Args:
        command: as it came.
        names: of all joints.
        limits: n x 2, lower and upper, rad.
        before: the setpoint that was accepted last, rad.
        step: how far each joint may get in one frame, rad.

    Returns:
        The setpoint in the order of ``names``; nothing where it holds.
    """
    valid_s = command.valid_for.seconds + command.valid_for.nanos / NS_PER_S
    if command.hold:
        return None
    require(0 < valid_s <= 1, f"valid_for of {valid_s:g} s", "above 0, at most 1 s")
    given = {joint.name: joint.position_rad for joint in command.joints}
    seen = f"joints {', '.join(given) or 'none'}"
    require(len(given) == len(command.joints) and set(given) == set(names), seen, f"each once: {', '.join(names)}")
    q = np.array([given[name] for name in names])
    require(bool(np.isfinite(q).all()), f"setpoint {_rounded(q)}", "finite numbers")
    inside = (q >= limits[:, 0] - _ROUNDING_RAD) & (q <= limits[:, 1] + _ROUNDING_RAD)
    outside = [name for name, ok in zip(names, inside, strict=True) if not ok]
    require(not outside, f"{', '.join(outside)} outside of its limits: {_rounded(q)}", "setpoints within the limits")
    moved = np.abs(q - before)
    for name, by, most in zip(names, moved, step, strict=True):
        seen = f"{name} {by:.3f} rad from the accepted setpoint"
        require(by <= most + _ROUNDING_RAD, seen, f"at most {most:.3f} rad in one frame")
    return q


def check_near(what: str, seen: Array, expected: Array, tolerance: float, unit: str) -> None:
    """Two vectors are the same within a tolerance, in each component."""
    off = float(np.abs(seen - expected).max()) if np.isfinite(seen).all() else float("inf")
    if off > tolerance:
        raise UnfulfilledError(
            f"{what} {_rounded(seen)}, {off:.3g} {unit} off", f"{_rounded(expected)} within {tolerance:g} {unit}"
        )


def check_covariance(marker: str, covariance: Sequence[float]) -> None:
    """Row-major 3x3, finite, symmetric, positive."""
    require(len(covariance) == 9, f"{len(covariance)} numbers for {marker}", "9, row by row")
    matrix = np.reshape(np.array(covariance), (3, 3))
    require(bool(np.isfinite(matrix).all()), f"covariance of {marker} is not finite", "finite numbers")
    symmetric = np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-12)
    require(bool(symmetric), f"covariance of {marker} is not symmetric", "a symmetric matrix")
    least = float(np.linalg.eigvalsh(matrix).min())
    require(least > 0, f"covariance of {marker} has the eigenvalue {least:.2g} m²", "positive ones")


def check_monotonic(what: str, times_ns: Iterable[int]) -> None:
    """Instants only go on."""
    for before, after in pairwise(times_ns):
        seen = f"{what} went back by {(before - after) / NS_PER_S:.3f} s"
        require(after >= before, seen, "time that only goes on")


def check_names(what: str, seen: Iterable[str], expected: Iterable[str]) -> None:
    """The same names, each once, in any order."""
    found, wanted = sorted(seen), sorted(expected)
    require(found == wanted, f"{what} {', '.join(found) or 'none'}", f"each once: {', '.join(wanted)}")


def check_description(arm: ArmDescription) -> None:
    """A serial chain of revolute joints with markers, a tip and cameras, each of a name of its own."""
    joints = [joint.name for joint in arm.joints]
    for what, names in (
        ("joints", joints),
        ("markers", [marker.name for marker in arm.markers]),
        ("cameras", list(arm.cameras)),
    ):
        require(bool(names) and all(names), f"{what} {names}", "some, each with a name")
        require(len(set(names)) == len(names), f"{what} {', '.join(names)}", "each once")
    turn = arm.world_from_base.rotation
    _check_unit("world_from_base's rotation", (turn.w, turn.x, turn.y, turn.z))
    for joint in arm.joints:
        _check_unit(f"axis of {joint.name}", (joint.axis.x, joint.axis.y, joint.axis.z))
        seen = f"{joint.name} from {joint.lower_rad:g} to {joint.upper_rad:g} rad at {joint.max_speed_rad_s:g} rad/s"
        require(joint.lower_rad < joint.upper_rad and joint.max_speed_rad_s > 0, seen, "limits in order, and a speed")
    for marker in arm.markers:
        require(marker.radius_m > 0, f"{marker.name} with a radius of {marker.radius_m:g} m", "a radius above 0")
    carriers = {marker.name: marker.centre.joint for marker in arm.markers} | {"tip": arm.tip.joint}
    for name, carrier in carriers.items():
        seen = f"{name} on {carrier!r}"
        require(carrier in ("", *joints), seen, f"one of {', '.join(joints)}, or none for the base")


def check_calibration(camera: str, calibration: CameraCalibration) -> None:
    """A pinhole camera of some size."""
    require(len(calibration.K) == 9, f"{len(calibration.K)} numbers in K of camera {camera}", "9")
    fx, fy, size = calibration.K[0], calibration.K[4], (calibration.width, calibration.height)
    require(fx > 0 and fy > 0, f"focal lengths {fx:g}, {fy:g} px of camera {camera}", "both above 0")
    require(min(size) > 0, f"camera {camera} of {size[0]} x {size[1]}", "its size in pixels")


def check_pose(camera: str, pose: FrameTransform) -> None:
    """T_world_optical."""
    require(pose.parent_frame_id == "world", f"camera {camera} in {pose.parent_frame_id!r}", "'world'")
    turn = pose.rotation
    _check_unit(f"rotation of camera {camera}", (turn.w, turn.x, turn.y, turn.z))


def _check_unit(what: str, values: tuple[float, ...]) -> None:
    length = float(np.linalg.norm(values))
    require(abs(length - 1) < 1e-6, f"{what} has the length {length:.6f}", "1")


def _rounded(values: Array) -> str:
    return "(" + ", ".join(f"{value:.3f}" for value in values) + ")"
