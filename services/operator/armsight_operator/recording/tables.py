"""A recording as tables: CSV, one file a table, a row for each thing that a message tells of at an instant.

Times are Unix nanoseconds: ``capture_ns`` names the instant and joins the tables, ``log_ns`` is when the message came.
Angles in rad, positions in metres.
"""

import csv
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from armsight import topics
from armsight.times import from_duration
from armsight.topics import Topic
from armsight.v1.control_pb2 import ControlMode, ControlState, ControlStatus, SafetyCode
from armsight.v1.geometry_pb2 import Vector3
from armsight.v1.health_pb2 import Health, HealthStatus
from armsight.v1.joints_pb2 import JointCommand, JointPositions, MarkerStatus, StageTimes
from armsight_operator.errors import OperatorError
from armsight_operator.monitor import Enum, word
from armsight_operator.recording.reader import Entry, Recording

Row = list[object]

_STAGES = [field.name for field in StageTimes.DESCRIPTOR.fields]
_COVARIANCE = [f"covariance_{a}{b}" for a in "xyz" for b in "xyz"]

COLUMNS: dict[str, list[str]] = {
    "joints": ["capture_ns", "log_ns", "of", "joint", "position_rad", "velocity_rad_s"],
    "positions": ["capture_ns", "log_ns", "marker", "status", "x", "y", "z", *_COVARIANCE, "age_s"],
    "observations": ["capture_ns", "marker", "camera", "u_px", "v_px", "radius_px", "area_px", "visible"],
    "command": ["capture_ns", "log_ns", "hold", "valid_s", "joint", "position_rad"],
    "status": [
        *("capture_ns", "log_ns", "mode", "state", "safety", "detail", "estimator", "tip_x", "tip_y", "tip_z"),
        *("target_x", "target_y", "target_z", "target_reachable", "clearance_m", *_STAGES),
    ],
    "health": ["log_ns", "service", "status", "detail", "kind", "name", "value"],
}
"""Of each table. A command without motion has one row without a joint; health without counters one without a name."""


def export(recording: Recording, folder: Path) -> dict[str, int]:
    """Writes ``joints.csv``, ``positions.csv`` and so on.

    Returns:
        Rows by table.

    Raises:
        OperatorError: the folder can't be written to.
    """
    counts = dict.fromkeys(COLUMNS, 0)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as files:
            writers = {}
            for table, columns in COLUMNS.items():
                path = folder / f"{table}.csv"
                file = files.enter_context(path.open("w", encoding="utf-8", newline=""))
                writers[table] = csv.writer(file)
                writers[table].writerow(columns)
            for table, row in _rows(recording):
                writers[table].writerow(row)
                counts[table] += 1
    except OSError as error:
        raise OperatorError(f"can't write tables to {folder}: {error.strerror}") from error
    return counts


def _rows(recording: Recording) -> Iterator[tuple[str, Row]]:
    wanted = [topic for topic in topics.TOPICS if topic.name in _TABLES]
    for topic, entry, message in recording.messages(wanted):
        yield from _TABLES[topic.name](topic, entry, message)


def _joints(topic: Topic[Any], entry: Entry, message: Any) -> Iterator[tuple[str, Row]]:
    of = topic.name.removeprefix("joints_")
    for joint in message.joints:
        velocity = joint.velocity if joint.HasField("velocity") else ""
        yield "joints", [entry.instant_ns, entry.log_ns, of, joint.name, joint.position, velocity]


def _positions(topic: Topic[Any], entry: Entry, message: JointPositions) -> Iterator[tuple[str, Row]]:
    del topic
    for marker in message.markers:
        status = _word(MarkerStatus, marker.status, "MARKER_STATUS_")
        place = _point(marker.position if marker.HasField("position") else None)
        covariance: Row = list(marker.covariance) or [""] * len(_COVARIANCE)
        age = from_duration(marker.age)
        yield "positions", [entry.instant_ns, entry.log_ns, marker.name, status, *place, *covariance, age]
        for seen in marker.observations:
            disc = [seen.u_px, seen.v_px, seen.radius_px, seen.area_px, seen.visible]
            yield "observations", [entry.instant_ns, marker.name, seen.camera, *disc]


def _command(topic: Topic[Any], entry: Entry, message: JointCommand) -> Iterator[tuple[str, Row]]:
    del topic
    about: Row = [entry.instant_ns, entry.log_ns, int(message.hold), from_duration(message.valid_for)]
    if not message.joints:
        yield "command", [*about, "", ""]
    for joint in message.joints:
        yield "command", [*about, joint.name, joint.position_rad]


def _status(topic: Topic[Any], entry: Entry, message: ControlStatus) -> Iterator[tuple[str, Row]]:
    del topic
    has_instant = message.HasField("capture_time")
    yield (
        "status",
        [
            entry.instant_ns if has_instant else "",
            entry.log_ns,
            _word(ControlMode, message.mode, "CONTROL_MODE_"),
            _word(ControlState, message.state, "CONTROL_STATE_"),
            _word(SafetyCode, message.safety, "SAFETY_CODE_"),
            message.detail,
            message.estimator,
            *_point(message.tip if message.HasField("tip") else None),
            *_point(message.target if message.HasField("target") else None),
            int(message.target_reachable) if message.HasField("target") else "",
            message.clearance_m if message.HasField("clearance_m") else "",
            *(getattr(message.stages, stage) or "" for stage in _STAGES),
        ],
    )


def _health(topic: Topic[Any], entry: Entry, message: Health) -> Iterator[tuple[str, Row]]:
    del topic
    status = _word(HealthStatus, message.status, "HEALTH_STATUS_")
    about: Row = [entry.log_ns, message.service, status, message.detail]
    values: list[tuple[object, ...]] = [("counter", name, value) for name, value in sorted(message.counters.items())]
    values += [("gauge", name, value) for name, value in sorted(message.gauges.items())]
    for value in values or [("", "", "")]:
        yield "health", [*about, *value]


_TABLES: dict[str, Callable[[Topic[Any], Entry, Any], Iterator[tuple[str, Row]]]] = {
    topics.JOINTS_TRUE.name: _joints,
    topics.JOINTS_ESTIMATED.name: _joints,
    topics.JOINTS_ACCEPTED.name: _joints,
    topics.JOINT_POSITIONS.name: _positions,
    topics.JOINT_COMMAND.name: _command,
    topics.CONTROL_STATUS.name: _status,
    topics.HEALTH.name: _health,
}


def _point(point: Vector3 | None) -> Row:
    return ["", "", ""] if point is None else [point.x, point.y, point.z]


def _word(enum: Enum, value: int, prefix: str) -> str:
    return word(enum, value, prefix).replace("_", "-")
