"""The keys of the bus with their messages and quality of service, read from ``topics.toml`` (their one home)."""

import re
import tomllib
from dataclasses import dataclass
from importlib import resources
from typing import Any, Generic, Literal, TypeVar

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Point3InFrame_pb2 import Point3InFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.empty_pb2 import Empty
from google.protobuf.message import Message

from armsight.v1.control_pb2 import (
    ControlStatus,
    ForwardKinematicsRequest,
    ForwardKinematicsResponse,
    SetModeRequest,
    SetModeResponse,
    SolveIkRequest,
    SolveIkResponse,
)
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.health_pb2 import Health
from armsight.v1.joints_pb2 import JointCommand, JointPositions
from armsight.v1.parameters_pb2 import Parameters, ParametersResponse, SetParametersRequest
from armsight.v1.safety_pb2 import StopRequest, StopResponse, StopState
from armsight.v1.sim_pb2 import Clock, ResetRequest, ResetResponse

M = TypeVar("M", bound=Message)
Request = TypeVar("Request", bound=Message)
Response = TypeVar("Response", bound=Message)

Delivery = Literal["latched", "drop", "block"]

NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")
"""Of cameras and markers: what may stand for {name} in a key."""

SERVICES = ("sim", "vision", "control")
"""The services of the loop, in the order in which data pass them."""

EACH = (*SERVICES, "camera", "recorder")
"""Those that have a health of their own: what the table calls "each"."""

WHO = (*EACH, "operator", "viewer")
"""Everybody to whom the table gives rights."""


@dataclass(frozen=True, slots=True)
class Topic(Generic[M]):
    """One row of the table: a key (relative to the namespace), its message and its quality of service."""

    name: str
    key: str
    message: type[M]
    publishers: tuple[str, ...]
    readers: tuple[str, ...]
    delivery: Delivery
    priority: str
    ring: int
    express: bool = False
    watchers: tuple[str, ...] = ()
    """Of the liveliness token that each publisher holds on the same key; none: there is no token."""

    def key_for(self, name: str | None = None) -> str:
        """The key with ``{name}`` filled in (``*`` for all of them)."""
        return _fill(self.key, name)

    def name_in(self, key: str) -> str:
        """What stands for ``{name}`` in a key of this topic; empty where the topic has no name."""
        return _name_in(self.key, key)


@dataclass(frozen=True, slots=True)
class Query(Generic[Request, Response]):
    """A queryable: its key, what it is asked and what it answers."""

    name: str
    key: str
    request: type[Request]
    response: type[Response]
    servers: tuple[str, ...]
    callers: tuple[str, ...]

    def key_for(self, name: str | None = None) -> str:
        """The key with ``{name}`` filled in."""
        return _fill(self.key, name)


def encoding_of(message: type[Message]) -> str:
    """The encoding that every put of this message carries."""
    return f"application/protobuf;{message.DESCRIPTOR.full_name}"


def _fill(key: str, name: str | None) -> str:
    if ("{name}" in key) != (name is not None):
        raise ValueError(f"key {key!r} {'needs' if name is None else 'takes no'} name")
    return key.replace("{name}", name) if name is not None else key


def _name_in(pattern: str, key: str) -> str:
    parts = dict(zip(reversed(pattern.split("/")), reversed(key.split("/")), strict=False))
    return parts.get("{name}", "")


def _load_table() -> dict[str, dict[str, dict[str, Any]]]:
    table = tomllib.loads(resources.files("armsight").joinpath("topics.toml").read_text(encoding="utf-8"))
    return {kind: {row["name"]: row for row in table[kind]} for kind in ("topic", "query")}


def _who(row: dict[str, Any], column: str) -> tuple[str, ...]:
    value = row.get(column)
    names = (value,) if isinstance(value, str) else tuple(value or ())
    if unknown := {name.partition("/")[0] for name in names} - {*WHO, "each"}:
        raise ValueError(
            f"topics.toml: {column} of {row['name']} is {sorted(unknown)}, not of {', '.join(WHO)} or each"
        )
    if "{name}" not in row["key"] and any(name == "each" or "/" in name for name in names):
        raise ValueError(f"topics.toml: {column} of {row['name']} is {names}, but its key has no {{name}}")
    return names


_TABLE = _load_table()


def _topic(name: str, message: type[M]) -> Topic[M]:
    row = _TABLE["topic"][name]
    declared = row["message"]
    if declared != message.DESCRIPTOR.full_name:
        raise ValueError(f"topics.toml gives {name} the message {declared}, the code {message.DESCRIPTOR.full_name}")
    return Topic(
        name=name,
        key=row["key"],
        message=message,
        publishers=_who(row, "publisher"),
        readers=_who(row, "readers"),
        delivery=row["delivery"],
        priority=row["priority"],
        ring=row["ring"],
        express=row.get("express", False),
        watchers=_who(row, "watchers"),
    )


def _query(name: str, request: type[Request], response: type[Response]) -> Query[Request, Response]:
    row = _TABLE["query"][name]
    declared = (row["request"] or "google.protobuf.Empty", row["response"])
    if declared != (request.DESCRIPTOR.full_name, response.DESCRIPTOR.full_name):
        raise ValueError(f"topics.toml gives {name} the messages {declared}, the code others")
    return Query(
        name=name,
        key=row["key"],
        request=request,
        response=response,
        servers=_who(row, "server"),
        callers=_who(row, "callers"),
    )


DESCRIPTION = _topic("description", ArmDescription)
CAMERA_CALIBRATION = _topic("camera_calibration", CameraCalibration)
CAMERA_POSE = _topic("camera_pose", FrameTransform)
CAMERA_IMAGE = _topic("camera_image", RawImage)
CAMERA_ANNOTATIONS = _topic("camera_annotations", ImageAnnotations)
JOINT_POSITIONS = _topic("joint_positions", JointPositions)
JOINTS_ESTIMATED = _topic("joints_estimated", JointStates)
JOINTS_TRUE = _topic("joints_true", JointStates)
JOINT_COMMAND = _topic("joint_command", JointCommand)
JOINTS_ACCEPTED = _topic("joints_accepted", JointStates)
TARGET = _topic("target", Point3InFrame)
CONTROL_STATUS = _topic("control_status", ControlStatus)
STOP_STATE = _topic("stop_state", StopState)
HEALTH = _topic("health", Health)
CLOCK = _topic("clock", Clock)
PARAMETERS = _topic("parameters", Parameters)

TOPICS: tuple[Topic[Any], ...] = (
    DESCRIPTION,
    CAMERA_CALIBRATION,
    CAMERA_POSE,
    CAMERA_IMAGE,
    CAMERA_ANNOTATIONS,
    JOINT_POSITIONS,
    JOINTS_ESTIMATED,
    JOINTS_TRUE,
    JOINT_COMMAND,
    JOINTS_ACCEPTED,
    TARGET,
    CONTROL_STATUS,
    STOP_STATE,
    HEALTH,
    CLOCK,
    PARAMETERS,
)

STOP = _query("stop", StopRequest, StopResponse)
RELEASE = _query("release", StopRequest, StopResponse)
RESET = _query("reset", ResetRequest, ResetResponse)
SOLVE_IK = _query("solve_ik", SolveIkRequest, SolveIkResponse)
FORWARD_KINEMATICS = _query("forward_kinematics", ForwardKinematicsRequest, ForwardKinematicsResponse)
MODE = _query("mode", SetModeRequest, SetModeResponse)
ASK_PARAMETERS = _query("parameters", Empty, ParametersResponse)
SET_PARAMETERS = _query("set_parameters", SetParametersRequest, ParametersResponse)
SCHEMA = _query("schema", Empty, FileDescriptorSet)

QUERIES: tuple[Query[Any, Any], ...] = (
    STOP,
    RELEASE,
    RESET,
    SOLVE_IK,
    FORWARD_KINEMATICS,
    MODE,
    ASK_PARAMETERS,
    SET_PARAMETERS,
    SCHEMA,
)
