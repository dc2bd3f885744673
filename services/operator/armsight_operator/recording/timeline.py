"""What a recording tells of an arm's motion, by what told it: the stream that the invariants are held against."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from armsight import topics
from armsight.router_watch import ROUTER_LOST
from armsight.times import NS_PER_S, from_duration, from_timestamp
from armsight.topics import Topic
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.health_pb2 import Health
from armsight.v1.joints_pb2 import JointCommand
from armsight.v1.safety_pb2 import StopState
from armsight.v1.sim_pb2 import Clock
from armsight_operator.errors import NoDataError
from armsight_operator.recording.reader import Entry

Array = npt.NDArray[np.float64]

WANTED = (
    topics.DESCRIPTION,
    topics.CLOCK,
    topics.JOINTS_TRUE,
    topics.JOINTS_ACCEPTED,
    topics.JOINTS_ESTIMATED,
    topics.JOINT_COMMAND,
    topics.STOP_STATE,
    topics.HEALTH,
)


@dataclass(frozen=True, slots=True)
class Joints:
    """The arm's joints, in the order of all angles here; rad, rad/s."""

    names: tuple[str, ...]
    lower: Array
    upper: Array
    max_speed: Array


@dataclass(frozen=True, slots=True)
class Frame:
    """One message of the clock."""

    log_ns: int
    instant_ns: int
    number: int
    period_ns: int

    @property
    def begin_ns(self) -> int:
        """The instant of frame 0."""
        return self.instant_ns - self.number * self.period_ns


@dataclass(frozen=True, slots=True)
class State:
    """Angles at an instant, rad."""

    log_ns: int
    instant_ns: int
    angles: Array


@dataclass(frozen=True, slots=True)
class Command:
    """One message of joints/command."""

    log_ns: int
    answers_ns: int
    valid_ns: int
    goal: Array | None
    """None where it is a hold, or does not name the arm's joints."""
    frames_sent_ns: int
    """When sim, or a camera, sent the frames that it answers, by the wall clock there."""


@dataclass(frozen=True, slots=True)
class Stop:
    """What sim said of the stop."""

    log_ns: int
    stopped: bool


@dataclass(frozen=True, slots=True)
class Said:
    """One message of a service's health."""

    log_ns: int
    instance: str
    status: int
    router_lost: int
    """How often this instance had lost its router by then."""


@dataclass(slots=True)
class Timeline:
    """All of it, each in the order in which it came."""

    joints: Joints
    frames: list[Frame] = field(default_factory=list)
    true: list[State] = field(default_factory=list)
    accepted: list[State] = field(default_factory=list)
    estimated: list[State] = field(default_factory=list)
    commands: list[Command] = field(default_factory=list)
    stops: list[Stop] = field(default_factory=list)
    health: dict[str, list[Said]] = field(default_factory=dict)
    deaf_ns: list[tuple[int, int]] = field(default_factory=list)
    """From when to when, by the recorder's clock, it lost commands for want of room."""


@dataclass(frozen=True, slots=True)
class Life:
    """What one process of sim did, from its start to its end."""

    begin_ns: int
    period_ns: int
    frames: tuple[Frame, ...]
    true: tuple[State, ...]
    accepted: tuple[State, ...]
    estimated: tuple[State, ...]
    commands: tuple[Command, ...]
    """That answer an instant of it."""


def timeline_of(messages: Iterable[tuple[Topic[Any], Entry, Any]]) -> Timeline:
    """Gathers decoded messages of :data:`WANTED`, in the order in which they came.

    Raises:
        NoDataError: there is no description, no clock, or no state of the joints.
    """
    kept = list(messages)
    described = next((message for _, _, message in kept if isinstance(message, ArmDescription)), None)
    if described is None:
        raise NoDataError(f"no {topics.DESCRIPTION.key} in the recording: its limits are what the motion is held to")
    found = Timeline(_joints(described))
    sequence = 0
    for topic, entry, message in kept:
        if isinstance(message, JointCommand):
            if sequence and entry.sequence > sequence + 1:
                before_ns = found.commands[-1].log_ns
                found.deaf_ns.append((before_ns, entry.log_ns))
            sequence = entry.sequence
        _take(found, topic, entry, message)
    for topic, states in (
        (topics.CLOCK, found.frames),
        (topics.JOINTS_TRUE, found.true),
        (topics.JOINTS_ACCEPTED, found.accepted),
    ):
        if not states:
            raise NoDataError(f"no {topic.key} in the recording: record it as well")
    return found


def lives(timeline: Timeline) -> list[Life]:
    """The motion of each process of sim, by the instants at which they began; each begins later than all before."""
    begins: list[Frame] = []
    for frame in timeline.frames:
        if not begins or frame.begin_ns > begins[-1].begin_ns + frame.period_ns // 2:
            begins.append(frame)
    edges = [0, *(frame.begin_ns - frame.period_ns // 2 for frame in begins[1:]), 2**63]

    def within(instant_ns: int, life: tuple[int, int]) -> bool:
        return life[0] <= instant_ns < life[1]

    return [
        Life(
            first.begin_ns,
            first.period_ns,
            tuple(frame for frame in timeline.frames if within(frame.instant_ns, life)),
            tuple(_each_once(state for state in timeline.true if within(state.instant_ns, life))),
            tuple(_each_once(state for state in timeline.accepted if within(state.instant_ns, life))),
            tuple(state for state in timeline.estimated if within(state.instant_ns, life)),
            tuple(command for command in timeline.commands if within(command.answers_ns, life)),
        )
        for first, life in zip(begins, pairwise(edges), strict=True)
    ]


def _each_once(states: Iterable[State]) -> Iterator[State]:
    """Without what came again, as what is latched does after the router was away."""
    last_ns = -1
    for state in states:
        if state.instant_ns > last_ns:
            last_ns = state.instant_ns
            yield state


def _take(found: Timeline, topic: Topic[Any], entry: Entry, message: Any) -> None:
    if isinstance(message, Clock):
        period_ns = round(from_duration(message.period) * NS_PER_S)
        found.frames.append(Frame(entry.log_ns, from_timestamp(message.capture_time), message.frame, period_ns))
    elif isinstance(message, JointStates):
        angles = _by_name(found.joints, {joint.name: joint.position for joint in message.joints})
        if angles is not None:
            states = {
                topics.JOINTS_TRUE: found.true,
                topics.JOINTS_ACCEPTED: found.accepted,
                topics.JOINTS_ESTIMATED: found.estimated,
            }
            states[topic].append(State(entry.log_ns, from_timestamp(message.timestamp), angles))
    elif isinstance(message, JointCommand):
        named = {joint.name: joint.position_rad for joint in message.joints}
        goal = None if message.hold else _by_name(found.joints, named)
        valid_ns = round(from_duration(message.valid_for) * NS_PER_S)
        answers_ns, sent_ns = from_timestamp(message.answers), message.stages.frames_sent_ns
        found.commands.append(Command(entry.log_ns, answers_ns, valid_ns, goal, sent_ns))
    elif isinstance(message, StopState):
        found.stops.append(Stop(entry.log_ns, message.stopped))
    elif isinstance(message, Health):
        said = Said(entry.log_ns, message.instance, message.status, message.counters.get(ROUTER_LOST, 0))
        found.health.setdefault(message.service, []).append(said)


def _by_name(joints: Joints, angles: dict[str, float]) -> Array | None:
    return np.array([angles[name] for name in joints.names]) if set(angles) == set(joints.names) else None


def _joints(described: ArmDescription) -> Joints:
    joints = described.joints
    return Joints(
        tuple(joint.name for joint in joints),
        np.array([joint.lower_rad for joint in joints]),
        np.array([joint.upper_rad for joint in joints]),
        np.array([joint.max_speed_rad_s for joint in joints]),
    )
