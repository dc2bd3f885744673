"""The instants that messages tell of one frame, and the stages between them. Nothing here knows the bus.

Instants are nanoseconds of Unix time by the clock of whoever wrote them: stages between two services mean something
where their clocks agree, as they do on one machine.
"""

from collections import OrderedDict, deque
from collections.abc import Mapping
from dataclasses import dataclass

from google.protobuf.message import Message

from armsight.times import from_timestamp
from armsight.topics import CLOCK, CONTROL_STATUS, JOINT_COMMAND, JOINT_POSITIONS
from armsight.v1.control_pb2 import ControlStatus
from armsight.v1.joints_pb2 import JointCommand, JointPositions, StageTimes
from armsight.v1.sim_pb2 import Clock

LONGEST_S = 60.0
"""A stage that took longer did not: somebody's clock is wrong."""

# What whoever listens writes down itself, beside the instants of StageTimes.
CLOCK_HEARD = "clock_heard_ns"
COMMAND_HEARD = "command_heard_ns"

KEYS = (CLOCK, JOINT_POSITIONS, JOINT_COMMAND, CONTROL_STATUS)
"""What tells of a frame: small keys, no images."""


@dataclass(frozen=True, slots=True)
class Stage:
    """What happens between two instants of a frame."""

    name: str
    begin: str
    """Names of instants."""
    end: str
    what: str
    who: str
    """Where the time goes by: a service, or ``bus``."""
    heard: bool = False
    """One of its ends is when the listener heard of it, by the listener's clock: no service's own word."""


STAGES = (
    Stage("draw", CLOCK_HEARD, "frames_sent_ns", "sim draws both frames", "sim", heard=True),
    Stage("frames", "frames_sent_ns", "vision_received_ns", "frames to vision", "bus"),
    Stage("vision", "vision_received_ns", "vision_sent_ns", "vision measures the markers", "vision"),
    Stage("positions", "vision_sent_ns", "control_received_ns", "positions to control", "bus"),
    Stage("control", "control_received_ns", "control_sent_ns", "control answers", "control"),
    Stage("command", "control_sent_ns", COMMAND_HEARD, "command as far as this listener", "bus", heard=True),
)
"""In the order in which a frame passes them."""

TOTAL = Stage("frame_to_command", "frames_sent_ns", "control_sent_ns", "frames sent to command sent", "all")

INSTANTS = (CLOCK_HEARD, *(field.name for field in StageTimes.DESCRIPTOR.fields), COMMAND_HEARD)
"""In the order in which a frame passes them."""


def instants_of(stages: StageTimes) -> dict[str, int]:
    """What a message says of its stages, without those that were not passed."""
    told = {field.name: int(getattr(stages, field.name)) for field in StageTimes.DESCRIPTOR.fields}
    return {name: ns for name, ns in told.items() if ns}


@dataclass(frozen=True, slots=True)
class Frame:
    """The instants that are known of one frame."""

    capture_ns: int
    instants: Mapping[str, int]
    """Nanoseconds of Unix time, by name."""

    def seconds(self, stage: Stage) -> float | None:
        """How long a stage took; nothing where an end is not known, or the clocks contradict each other."""
        begin, end = self.instants.get(stage.begin), self.instants.get(stage.end)
        if begin is None or end is None:
            return None
        took = (end - begin) / 1e9
        return took if 0.0 <= took <= LONGEST_S else None

    def contradicted(self, stage: Stage) -> bool:
        """Whether both ends are known and can't both be true.

        A listener that hears late of a stage's beginning contradicts nobody: it is late, whatever the clocks say.
        """
        if stage.begin == CLOCK_HEARD:
            return False
        return stage.begin in self.instants and stage.end in self.instants and self.seconds(stage) is None


class Joiner:
    """Joins what different messages tell of one frame, by its capture time; remembers the newest frames only."""

    def __init__(self, keep: int = 64) -> None:
        """Knows nothing yet; ``keep`` frames at most."""
        self._keep = keep
        self._frames: OrderedDict[int, dict[str, int]] = OrderedDict()
        self._given: deque[int] = deque(maxlen=keep)
        self._answered_ns: int | None = None

    def take(self, message: Message, heard_ns: int) -> Frame | None:
        """Takes one message of :data:`KEYS`; returns the frame that is complete with it, if one is.

        A frame is complete when the status of a later one comes: what tells of one frame goes over keys that may
        overtake each other.

        Args:
            message: as decoded.
            heard_ns: when it was received or recorded, nanoseconds of Unix time.
        """
        if isinstance(message, Clock):
            self._add(from_timestamp(message.capture_time), {CLOCK_HEARD: heard_ns})
        elif isinstance(message, JointCommand):
            self._add(from_timestamp(message.answers), {COMMAND_HEARD: heard_ns})
        elif isinstance(message, JointPositions):
            self._add(from_timestamp(message.capture_time), instants_of(message.stages))
        elif isinstance(message, ControlStatus):
            capture_ns = from_timestamp(message.capture_time)
            self._add(capture_ns, instants_of(message.stages))
            return self._complete(capture_ns)
        return None

    def rest(self) -> Frame | None:
        """The last frame, where no more messages come."""
        return self._complete(None)

    def _add(self, capture_ns: int, instants: Mapping[str, int]) -> None:
        """What was known before stays: an instant that is answered again gives the same answer."""
        if capture_ns in self._given:
            return
        known = self._frames.setdefault(capture_ns, {})
        for name, ns in instants.items():
            known.setdefault(name, ns)
        while len(self._frames) > self._keep:
            self._frames.popitem(last=False)

    def _complete(self, next_ns: int | None) -> Frame | None:
        before_ns, self._answered_ns = self._answered_ns, next_ns
        if before_ns is None or before_ns == next_ns:
            return None
        known = self._frames.pop(before_ns, None)
        if known is None:
            return None
        self._given.append(before_ns)
        return Frame(before_ns, known)
