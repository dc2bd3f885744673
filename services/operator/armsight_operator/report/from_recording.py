"""The report from a recording: every motion in it, measured by the same code as the live report's."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from google.protobuf.message import Message

from armsight import topics
from armsight.times import from_timestamp
from armsight.topics import Topic
from armsight.v1.control_pb2 import ControlMode, ControlStatus
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.health_pb2 import HEALTH_STATUS_OK, Health
from armsight.v1.joints_pb2 import JointPositions
from armsight_operator.errors import NoDataError
from armsight_operator.recording.reader import Recording
from armsight_operator.report import pages, plots, summary
from armsight_operator.report.chain import Arm, Array, arm_of
from armsight_operator.report.measure import Part, part_of
from armsight_operator.report.run import Instant

_SHORTEST = 2
"""Instants of a motion."""


@dataclass(frozen=True, slots=True)
class Motion:
    """What control did in one mode, from one change of mode to the next."""

    mode: str
    begin_s: float
    """Of its first instant, from the first instant of the recording."""
    frames: int
    part: Part | None
    """Beside the truth; none where no truth, or nothing that was estimated, was recorded."""
    tip_time_s: Array
    tip_distance_m: Array
    """From a target in reach, at those times: of the true tip where it is known, else of the estimated one."""


@dataclass(slots=True)
class Wellness:
    """What one service said of itself."""

    reports: int = 0
    not_ok: Counter[str] = field(default_factory=Counter)
    """Reports by what was wrong."""
    counters: dict[str, int] = field(default_factory=dict)
    """As it said last."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """Everything that a recording tells."""

    files: tuple[Path, ...]
    troubles: dict[Path, str]
    motions: list[Motion]
    latencies_ms: Array
    health: dict[str, Wellness]


_WANTED = (
    topics.DESCRIPTION,
    topics.CONTROL_STATUS,
    topics.JOINTS_ESTIMATED,
    topics.JOINTS_TRUE,
    topics.JOINT_POSITIONS,
    topics.HEALTH,
)


class _Tables:
    """Of each instant what was said of it."""

    def __init__(self, recording: Recording) -> None:
        self.description: ArmDescription | None = None
        self.statuses: list[ControlStatus] = []
        self.estimated: dict[int, Array] = {}
        self.true: dict[int, Array] = {}
        self.positions: dict[int, JointPositions] = {}
        self.health: dict[str, Wellness] = {}
        for topic, _, message in recording.messages(_WANTED):
            self._take(topic, message)

    def _take(self, topic: Topic[Any], message: Message) -> None:
        if isinstance(message, ArmDescription):
            self.description = message
        elif isinstance(message, ControlStatus):
            # without a capture time it says that no positions came for a while, and answers none
            if message.HasField("capture_time"):
                self.statuses.append(message)
        elif isinstance(message, JointPositions):
            self.positions.setdefault(from_timestamp(message.capture_time), message)
        elif isinstance(message, JointStates):
            table = self.true if topic is topics.JOINTS_TRUE else self.estimated
            table.setdefault(from_timestamp(message.timestamp), np.array([joint.position for joint in message.joints]))
        elif isinstance(message, Health):
            said = self.health.setdefault(message.service, Wellness())
            said.reports += 1
            said.counters = dict(message.counters)
            if message.status != HEALTH_STATUS_OK:
                said.not_ok[message.detail] += 1


def measure(recording: Recording) -> Recorded:
    """Reads all of it.

    Raises:
        NoDataError: it tells nothing of the arm.
    """
    tables = _Tables(recording)
    if tables.description is None or not tables.statuses:
        missing = "description" if tables.description is None else topics.CONTROL_STATUS.key
        raise NoDataError(f"no {missing} in {', '.join(map(str, recording.paths))}: record it as well")
    arm, cameras = arm_of(tables.description), len(tables.description.cameras)
    first_ns = from_timestamp(tables.statuses[0].capture_time)
    motions = [
        _motion(tables, statuses, arm, cameras, first_ns)
        for statuses in _by_mode(tables.statuses)
        if len(statuses) >= _SHORTEST
    ]
    latencies = [_latency_ms(status) for status in tables.statuses if status.stages.frames_sent_ns]
    return Recorded(recording.paths, dict(recording.troubles), motions, np.array(latencies), tables.health)


def instants_of(recording: Recording, mode: str) -> list[Instant]:
    """Every instant at which control was in a mode and of which all is known."""
    tables = _Tables(recording)
    return _instants(tables, [status for status in tables.statuses if _mode(status) == mode])


def to_json(recorded: Recorded) -> dict[str, Any]:
    """What ``summary.json`` holds; metres, radians, milliseconds."""
    return {
        "files": [str(path) for path in recorded.files],
        "complete": not recorded.troubles,
        "troubles": {str(path): trouble for path, trouble in recorded.troubles.items()},
        "motions": [_motion_figures(motion) for motion in recorded.motions],
        "latency_ms": summary.latency_figures(recorded.latencies_ms) if recorded.latencies_ms.size else None,
        "health": {
            name: {"reports": said.reports, "not_ok": dict(said.not_ok), "counters": said.counters}
            for name, said in sorted(recorded.health.items())
        },
    }


def to_markdown(recorded: Recorded) -> str:
    """The same for people."""
    figures = to_json(recorded)
    lines = ["# armsight report", "", f"From the recording {', '.join(path.name for path in recorded.files)}.", ""]
    lines += [f"Not whole: {path.name}: {trouble}.\n" for path, trouble in recorded.troubles.items()]
    for number, motion in enumerate(figures["motions"]):
        seconds = f"{motion['begin_s']:.1f} to {motion['end_s']:.1f} s"
        lines += [f"## {motion['mode']}, {seconds}", "", f"{motion['frames']} instants.", ""]
        if motion["joints"] is not None:
            lines += summary.part_lines(_key(number), motion["joints"])
        else:
            lines += ["No truth was recorded of it, so there are no errors to tell.", ""]
        if motion["tip"] is not None:
            tip = motion["tip"]
            lines += [
                f"Tip from its target, where in reach: RMS {1000 * tip['rms']:.1f} mm, p99 {1000 * tip['p99']:.1f} mm.",
                "",
                f"![tip from target]({_key(number)}_tip.png)",
                "",
            ]
    if figures["latency_ms"] is not None:
        lines += summary.latency_lines(figures["latency_ms"])
    lines += ["## Health", "", "| service | reports | not well | last counters |", "|---|---|---|---|"]
    for name, said in figures["health"].items():
        wrong = "; ".join(f"{count} × {detail or 'no detail'}" for detail, count in said["not_ok"].items())
        counters = ", ".join(f"{counter} {total}" for counter, total in sorted(said["counters"].items()))
        lines.append(f"| {name} | {said['reports']} | {_cell(wrong)} | {_cell(counters)} |")
    return "\n".join([*lines, ""])


def write(recorded: Recorded, folder: Path) -> None:
    """The page, the Markdown, the JSON and the plots."""
    for number, motion in enumerate(recorded.motions):
        if motion.part is not None:
            plots.plot_part(motion.part, folder, _key(number))
        if motion.tip_distance_m.size:
            plots.plot_tip(motion.tip_time_s, motion.tip_distance_m, folder / f"{_key(number)}_tip.png")
    pages.write(to_markdown(recorded), to_json(recorded), folder)


def headlines(recorded: Recorded) -> list[str]:
    """One line for each motion."""
    lines = []
    for motion in map(_motion_figures, recorded.motions):
        parts = [f"{motion['mode']}, {motion['frames']} instants"]
        if motion["joints"] is not None:
            rms = ", ".join(f"{symbol} {1000 * value:.1f}" for symbol, value in motion["joints"]["rms"].items())
            parts.append(f"RMS, mrad: {rms}")
        if motion["tip"] is not None:
            parts.append(f"tip {1000 * motion['tip']['rms']:.1f} mm from target")
        lines.append("; ".join(parts))
    return lines


def _motion_figures(motion: Motion) -> dict[str, Any]:
    tip = motion.tip_distance_m
    end_s = motion.begin_s if motion.part is None else float(motion.part.time_s[-1])
    if motion.part is None and tip.size:
        end_s = float(motion.tip_time_s[-1])
    return {
        "mode": motion.mode,
        "begin_s": motion.begin_s,
        "end_s": end_s,
        "frames": motion.frames,
        "joints": None if motion.part is None else summary.part_figures(motion.part),
        "tip": {"rms": float(np.sqrt(np.mean(tip**2))), "p99": float(np.percentile(tip, 99)), "frames": len(tip)}
        if tip.size
        else None,
    }


def _motion(tables: _Tables, statuses: list[ControlStatus], arm: Arm, cameras: int, first_ns: int) -> Motion:
    begin_s = (from_timestamp(statuses[0].capture_time) - first_ns) / 1e9
    instants = _instants(tables, statuses)
    part = None
    if len(instants) >= _SHORTEST:
        part = part_of(_mode(statuses[0]), instants, arm, cameras, (instants[0].capture_ns - first_ns) / 1e9)
    times, distances = [], []
    for status in statuses:
        if not (status.HasField("target") and status.target_reachable):
            continue
        stamp = from_timestamp(status.capture_time)
        true = tables.true.get(stamp)
        tip = np.array([status.tip.x, status.tip.y, status.tip.z]) if true is None else arm.tip_at(true)
        times.append((stamp - first_ns) / 1e9)
        distances.append(float(np.linalg.norm(tip - [status.target.x, status.target.y, status.target.z])))
    return Motion(_mode(statuses[0]), begin_s, len(statuses), part, np.array(times), np.array(distances))


def _instants(tables: _Tables, statuses: Iterable[ControlStatus]) -> list[Instant]:
    instants = []
    for status in statuses:
        stamp = from_timestamp(status.capture_time)
        estimated, true = tables.estimated.get(stamp), tables.true.get(stamp)
        positions = tables.positions.get(stamp)
        if estimated is not None and true is not None and positions is not None:
            instants.append(Instant(stamp, estimated, true, positions, _latency_ms(status)))
    return instants


def _by_mode(statuses: Iterable[ControlStatus]) -> list[list[ControlStatus]]:
    """From one change of mode to the next; an instant that was answered again counts once."""
    runs: list[list[ControlStatus]] = []
    for status in statuses:
        if not runs or runs[-1][-1].mode != status.mode:
            runs.append([])
        if not runs[-1] or from_timestamp(status.capture_time) > from_timestamp(runs[-1][-1].capture_time):
            runs[-1].append(status)
    return runs


def _latency_ms(status: ControlStatus) -> float:
    return (status.stages.control_sent_ns - status.stages.frames_sent_ns) / 1e6


def _mode(status: ControlStatus) -> str:
    return ControlMode.Name(status.mode).removeprefix("CONTROL_MODE_").lower().replace("_", "-")


def _key(number: int) -> str:
    return f"motion{number + 1}"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
