"""A recording back onto the bus, in the place of those who said it: for vision or control without sim.

At a rate, message after message as it came; or in lockstep, where each instant waits for its answer as sim's do, and
the same frames give the same positions, bit for bit.
"""

import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from google.protobuf.empty_pb2 import Empty

from armsight.bus import Bus, Publisher, Subscriber
from armsight.errors import ConfigError, NoReplyError
from armsight.images import encode_sent
from armsight.times import from_timestamp, wall_ns
from armsight.topics import (
    ASK_PARAMETERS,
    CAMERA_IMAGE,
    HEALTH,
    JOINT_COMMAND,
    JOINT_POSITIONS,
    JOINTS_ACCEPTED,
    STOP_STATE,
    TOPICS,
    WHO,
    Topic,
)
from armsight_operator.errors import NoDataError, OperatorError
from armsight_operator.recording.reader import Entry, Recording, topic_of

GUARDED = (JOINT_COMMAND, JOINTS_ACCEPTED, STOP_STATE, HEALTH)
"""Never replayed unasked: they move an arm, tell control where it is, say whether it is stopped, and who is well."""

_LISTENERS_S = 2.0
_LOCKSTEP_LISTENERS_S = 30.0
_SEND_AGAIN_S = 6.0
_GIVE_UP_S = 30.0
_POLL_S = 0.1
_SIM_ANSWERS_S = 1.0
_ANNOUNCED_S = 0.3
"""For everybody to have heard of it: what comes before is forgotten."""
_SOON_NS = 5_000_000_000


@dataclass(frozen=True, slots=True)
class Span:
    """A part of a recording, in seconds from its first message."""

    begin_s: float = 0.0
    end_s: float | None = None


@dataclass(slots=True)
class Played:
    """What was put on the bus."""

    messages: int = 0
    rounds: int = 0
    answered: int = 0
    """Instants, in lockstep."""
    late_s: float = 0.0
    """At worst, behind the time at which a message was due."""


def inputs_of(role: str, *, guarded: bool) -> list[Topic[Any]]:
    """The keys that somebody reads and does not put himself: what stands in for everybody else.

    Args:
        role: of the contract's table.
        guarded: whether with those of :data:`GUARDED`.

    Raises:
        ConfigError: there is nobody by this name.
    """
    if role not in WHO:
        raise ConfigError(f"there is no {role!r} on the bus; there are {', '.join(WHO)}")
    return [
        topic
        for topic in TOPICS
        if role in topic.readers and role not in topic.publishers and (guarded or topic not in GUARDED)
    ]


def check_no_sim(bus: Bus) -> None:
    """What has the arm must not be on the bus: it would move by what is replayed.

    Raises:
        OperatorError: it is.
    """
    try:
        bus.query(ASK_PARAMETERS, Empty(), "sim", timeout_s=_SIM_ANSWERS_S)
    except NoReplyError:
        return
    raise OperatorError(
        "sim is on this bus, and its arm would move by what was recorded: stop it, or replay where it is not, such as "
        "--namespace robots/replay; --beside-sim does it all the same"
    )


class Replay:
    """Puts the chosen keys of a recording on the bus."""

    def __init__(
        self,
        bus: Bus,
        recording: Recording,
        is_wanted: Callable[[Topic[Any], str], bool],
        *,
        lockstep: bool,
        as_sim: bool = True,
    ) -> None:
        """Declares publishers for what is recorded and wanted.

        Args:
            bus: where to.
            recording: where from.
            is_wanted: of a row of the table and a key of it.
            lockstep: whether each instant waits for its answer.
            as_sim: whether it is announced as a sim that has just come: then control begins anew, and takes times that
                lie before those it knows. Not where there is a sim.

        Raises:
            ConfigError: nothing of the recording is wanted, or nothing in it would be answered.
        """
        self._bus, self._recording, self._lockstep, self._as_sim = bus, recording, lockstep, as_sim
        self._outline = recording.outline()
        topics = {key: topic for key in self._outline.channels if (topic := topic_of(key)) and is_wanted(topic, key)}
        if not topics:
            there = ", ".join(sorted(self._outline.channels)) or "nothing"
            raise ConfigError(f"nothing of what is asked for was recorded; there is {there}")
        self._topics = topics
        answer: Topic[Any] | None = None
        self._asks: Topic[Any] | None = None
        if lockstep:
            self._asks, answer = self._question(list(topics.values()))
        self._answers: Subscriber[Any] | None = None if answer is None else bus.subscriber(answer, keep=256)
        self._publishers: dict[str, Publisher[Any]] = {
            key: bus.publisher(topic, topic.name_in(key) or None, block=(lockstep and topic is CAMERA_IMAGE) or None)
            for key, topic in sorted(topics.items())
        }

    @property
    def keys(self) -> Collection[str]:
        """That are replayed."""
        return self._topics.keys()

    def run(self, stop: threading.Event, span: Span, rate: float, *, loop: bool) -> Played:
        """Plays until the end, or until it is asked to stop.

        Args:
            stop: ends it.
            span: what to play.
            rate: recorded seconds a second; in lockstep the answers set the pace.
            loop: whether from the beginning again, with the same capture times.

        Raises:
            NoDataError: in lockstep nobody answers.
        """
        begin_ns = self._outline.begin_ns + round(span.begin_s * 1e9)
        end_ns = None if span.end_s is None else self._outline.begin_ns + round(span.end_s * 1e9)
        if begin_ns > self._outline.end_ns:
            seconds = (self._outline.end_ns - self._outline.begin_ns) / 1e9
            raise ConfigError(f"the recording is {seconds:.1f} s long: it can't start at {span.begin_s:g} s")
        played = Played()
        while not stop.is_set():
            with self._presence(stop):
                known = self._known_at(begin_ns)
                for entry in known:
                    self._put(entry, played)
                if played.rounds == 0:
                    self._await_listeners(stop)
                self._play(stop, (begin_ns, end_ns), rate, {(entry.key, entry.sequence) for entry in known}, played)
            played.rounds += 1
            if not loop:
                break
        return played

    @contextmanager
    def _presence(self, stop: threading.Event) -> Iterator[None]:
        """Sim's liveliness token, for one round."""
        if not self._as_sim:
            yield
            return
        token = self._bus.session.liveliness().declare_token(HEALTH.key_for("sim"))
        stop.wait(_ANNOUNCED_S)
        try:
            yield
        finally:
            token.undeclare()  # type: ignore[no-untyped-call]

    def _known_at(self, begin_ns: int) -> list[Entry]:
        """What is latched when it begins: said before, or else soon after, as a recorder that comes late hears it."""
        latched = [key for key, topic in self._topics.items() if topic.delivery == "latched"]
        before = self._recording.last_before(latched, begin_ns)
        missing = set(latched) - {entry.key for entry in before}
        soon: dict[str, Entry] = {}
        for entry in self._recording.entries(missing, begin_ns, begin_ns + _SOON_NS) if missing else ():
            soon.setdefault(entry.key, entry)
            if len(soon) == len(missing):
                break
        return [*before, *soon.values()]

    def _play(
        self,
        stop: threading.Event,
        span_ns: tuple[int, int | None],
        rate: float,
        known: Collection[tuple[str, int]],
        played: Played,
    ) -> None:
        started, (begin_ns, end_ns) = time.monotonic(), span_ns
        question: list[Entry] = []
        for entry in self._recording.entries(self._topics, begin_ns, end_ns):
            if (entry.key, entry.sequence) in known:
                continue
            if self._lockstep:
                if question and self._opens_another(entry, question):
                    self._await_answer(stop, question, played)
                    question = []
                if self._topics[entry.key] is self._asks:
                    question.append(entry)
            else:
                due = started + (entry.log_ns - begin_ns) / 1e9 / rate
                stop.wait(max(0.0, due - time.monotonic()))
                played.late_s = max(played.late_s, time.monotonic() - due)
            if stop.is_set():
                return
            self._put(entry, played)
        if question:
            self._await_answer(stop, question, played)

    @staticmethod
    def _question(topics: list[Topic[Any]]) -> tuple[Topic[Any], Topic[Any]]:
        """What asks in lockstep, and what answers it."""
        for asks, answers in ((CAMERA_IMAGE, JOINT_POSITIONS), (JOINT_POSITIONS, JOINT_COMMAND)):
            if asks not in topics:
                continue
            if answers in topics:
                raise ConfigError(f"{answers.key} is what --lockstep waits for: it can't be replayed as well")
            return asks, answers
        raise ConfigError("--lockstep needs frames or positions to replay: nothing else is answered")

    def _opens_another(self, entry: Entry, question: list[Entry]) -> bool:
        """Whether a message is of a later instant than the frames that are out: it would come too early."""
        return entry.instant_ns > question[0].instant_ns

    def _await_listeners(self, stop: threading.Event) -> None:
        """Until everybody who reads what is not latched is there: vision asks for frames once it knows the cameras."""
        asking = [
            publisher
            for key, publisher in self._publishers.items()
            if self._topics[key].delivery != "latched" and (not self._lockstep or self._topics[key] is self._asks)
        ]
        until = time.monotonic() + (_LOCKSTEP_LISTENERS_S if self._lockstep else _LISTENERS_S)
        while not all(publisher.has_subscribers() for publisher in asking):
            if stop.wait(0.02):
                return
            if time.monotonic() > until:
                if self._lockstep:
                    raise NoDataError("nobody listens to what is replayed: is vision, or control, running?")
                return

    def _await_answer(self, stop: threading.Event, question: list[Entry], played: Played) -> None:
        assert self._answers is not None
        instant, asked = question[0].instant_ns, time.monotonic()
        sent = asked
        while not stop.is_set():
            received = self._answers.recv(_POLL_S)
            if received is not None and _answered_instant(received.message) == instant:
                played.answered += 1
                return
            now = time.monotonic()
            if now - asked > _GIVE_UP_S:
                who = "vision" if self._asks is CAMERA_IMAGE else "control"
                raise NoDataError(f"the instant {instant} is not answered within {_GIVE_UP_S:g} s: is {who} well?")
            if now - sent > _SEND_AGAIN_S:
                sent = now
                for entry in question:
                    self._put(entry, None)

    def _put(self, entry: Entry, played: Played | None) -> None:
        attachment = encode_sent(wall_ns()) if self._topics[entry.key] is CAMERA_IMAGE else None
        self._publishers[entry.key].put_bytes(entry.payload, attachment)
        if played is not None:
            played.messages += 1


def _answered_instant(message: Any) -> int:
    return from_timestamp(message.answers if "answers" in message.DESCRIPTOR.fields_by_name else message.capture_time)
