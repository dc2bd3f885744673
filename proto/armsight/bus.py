"""Typed publishers, subscribers and queryables over one Zenoh session.

A subscriber keeps the newest samples and is read by a thread of its own: a full queue never blocks the session, and a
slow reader never delays another. What can't be decoded is counted and left out.
"""

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import monotonic
from typing import Any, Generic, TypeVar

import zenoh
import zenoh.ext
from google.protobuf.message import DecodeError, Message

from armsight.counters import Counters
from armsight.errors import ArmsightError, NoReplyError, RefusedError, SessionClosedError
from armsight.topics import HEALTH, Query, Topic, encoding_of

log = logging.getLogger(__name__)

M = TypeVar("M", bound=Message)
Request = TypeVar("Request", bound=Message)
Response = TypeVar("Response", bound=Message)

LATCHED_HEARTBEAT_S = 1.0
"""How often the publisher of a latched value says how many it has put."""

_MAX_QUERY_BYTES = 1 << 20

_UNASKED = 8
"""Samples that wait until somebody asks for the newest: what can't be decoded is counted, and hides none before it."""


@dataclass(frozen=True, slots=True)
class Received(Generic[M]):
    """One decoded sample."""

    message: M
    key: str
    name: str
    """What stood for ``{name}`` in the key."""
    received_s: float
    """Monotonic clock of this process."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One message as it came, for whoever keeps it or passes it on."""

    topic: Topic[Any]
    name: str
    """What stands for ``{name}`` in the key; empty where the topic has none."""
    payload: bytes
    attachment: bytes
    """Empty where there is none."""

    @property
    def key(self) -> str:
        """Relative to the namespace."""
        return self.topic.key_for(self.name or None)


class Publisher(Generic[M]):
    """Puts one kind of message on one key."""

    def __init__(self, inner: "zenoh.Publisher | zenoh.ext.AdvancedPublisher") -> None:
        """Made by :meth:`Bus.publisher`."""
        self._inner = inner

    def put(self, message: M) -> None:
        """Publishes a message; a put on a closed session is dropped."""
        self.put_bytes(message.SerializeToString())

    def put_bytes(self, payload: bytes | zenoh.ZBytes, attachment: bytes | None = None) -> None:
        """Publishes a message that is serialised already (frames), with bytes beside it where given."""
        try:
            self._inner.put(payload, attachment=attachment)
        except zenoh.ZError:
            log.debug("put on a closed session", extra={"key": str(self._inner.key_expr)})

    def has_subscribers(self) -> bool:
        """Whether anybody listens now; always true for latched values."""
        if not isinstance(self._inner, zenoh.Publisher):
            return True
        status: Any = self._inner.matching_status  # an object, always true, though Zenoh's stubs say bool
        return bool(status.matching)


class Subscriber(Generic[M]):
    """The newest samples of a key, decoded by a thread of its own."""

    def __init__(
        self,
        topic: Topic[M],
        inner: Any,
        keep: int,
        counters: Counters,
        on_message: Callable[[Received[M]], None] | None,
    ) -> None:
        """Made by :meth:`Bus.subscriber`."""
        self._topic = topic
        self._inner = inner
        self._counters = counters
        self._on_message = on_message
        self._arrived = threading.Condition()
        self._waiting: deque[Received[M]] = deque(maxlen=keep)
        self._latest: Received[M] | None = None
        self._lost = 0
        self._closed = False
        self.thread = threading.Thread(target=self._read, name=f"read {inner.key_expr}", daemon=True)
        self.thread.start()

    @property
    def latest(self) -> Received[M] | None:
        """The newest sample, taken or not."""
        return self._latest

    @property
    def lost(self) -> int:
        """Samples that were pushed out before they were taken."""
        return self._lost

    def recv(self, timeout_s: float | None = None) -> Received[M] | None:
        """Takes the oldest sample not taken yet; waits for one, up to ``timeout_s``.

        Raises:
            SessionClosedError: the session ended.
        """
        with self._arrived:
            if not self._arrived.wait_for(lambda: self._waiting or self._closed, timeout_s):
                return None
            if not self._waiting:
                raise SessionClosedError(f"session closed while waiting on {self._topic.key}")
            return self._waiting.popleft()

    def clear(self) -> None:
        """Forgets the samples not taken yet."""
        with self._arrived:
            self._waiting.clear()

    def close(self) -> None:
        """Stops listening."""
        self._inner.undeclare()
        self.thread.join(timeout=1.0)

    def _read(self) -> None:
        # not by the subscriber itself: a waiting recv() of its own would refuse undeclare()
        handler = self._inner.handler
        while True:
            try:
                sample = handler.recv()
            except zenoh.ZError:
                break
            message = _decoded(self._topic, sample, self._counters)
            if message is None:
                continue
            key = str(sample.key_expr)
            received = Received(message, key, self._topic.name_in(key), monotonic())
            self._latest = received
            if self._on_message is not None:
                self._call(self._on_message, received)
            with self._arrived:
                self._lost += len(self._waiting) == self._waiting.maxlen
                self._waiting.append(received)
                self._arrived.notify_all()
        with self._arrived:
            self._closed = True
            self._arrived.notify_all()

    def _call(self, on_message: Callable[[Received[M]], None], received: Received[M]) -> None:
        try:
            on_message(received)
        except Exception:
            self._counters.add(f"failed_{self._topic.name}")
            log.exception("handling a sample failed", extra={"key": received.key})


class Newest(Generic[M]):
    """The newest sample of a key, decoded when it is asked for.

    No thread reads it: where one publisher put two messages of equal priority, whoever has read the second finds the
    first here.
    """

    def __init__(self, topic: Topic[M], inner: Any, counters: Counters) -> None:
        """Made by :meth:`Bus.newest`."""
        self._topic = topic
        self._inner = inner
        self._counters = counters
        self._known: M | None = None

    def get(self) -> M | None:
        """What came last and could be decoded, now and whenever asked again; nothing before the first."""
        try:
            while (sample := self._inner.handler.try_recv()) is not None:
                message = _decoded(self._topic, sample, self._counters)
                if message is not None:
                    self._known = message
        except zenoh.ZError:  # the session ended
            pass
        return self._known


class Presence:
    """Which services hold their liveliness token now."""

    def __init__(self, session: zenoh.Session, on_change: Callable[[str, bool], None] | None) -> None:
        """Made by :meth:`Bus.presence`."""
        self._on_change = on_change
        self._alive: dict[str, int] = {}
        key = HEALTH.key_for("*")
        self._inner = session.liveliness().declare_subscriber(key, zenoh.handlers.RingChannel(64), history=True)
        self.thread = threading.Thread(target=self._read, name="presence", daemon=True)
        self.thread.start()

    def alive(self) -> frozenset[str]:
        """Names of the services that are there."""
        return frozenset(self._alive)

    def _read(self) -> None:
        while True:
            try:
                sample = self._inner.recv()
            except zenoh.ZError:
                return
            name = HEALTH.name_in(str(sample.key_expr))
            here = sample.kind == zenoh.SampleKind.PUT
            self._alive = self._alive | {name: 1} if here else {k: 1 for k in self._alive if k != name}
            if self._on_change is not None:
                self._on_change(name, here)


class Bus:
    """One process's place on the bus."""

    def __init__(self, session: zenoh.Session, counters: Counters | None = None) -> None:
        """Takes an open session; whoever opened it closes it."""
        self.session = session
        self.counters = counters if counters is not None else Counters()
        self._threads: list[threading.Thread] = []
        # a latched value is there for late subscribers as long as its publisher lives, whoever forgets it
        self._latched: list[zenoh.ext.AdvancedPublisher] = []

    def join(self, timeout_s: float = 1.0) -> None:
        """Waits for the reading threads of a closed session.

        One that is still inside Zenoh when the interpreter ends aborts the process ("exception not rethrown").
        """
        until = monotonic() + timeout_s
        for thread in self._threads:
            thread.join(timeout=max(0.0, until - monotonic()))

    def publisher(self, topic: Topic[M], name: str | None = None, *, block: bool | None = None) -> Publisher[M]:
        """Declares a publisher with the table's quality of service.

        Args:
            topic: the row of the table.
            name: what stands for ``{name}`` in its key.
            block: overrides the table's delivery (lockstep's frames).
        """
        key, encoding = topic.key_for(name), zenoh.Encoding(encoding_of(topic.message))
        priority = getattr(zenoh.Priority, topic.priority)
        wait = topic.delivery == "block" if block is None else block
        congestion = zenoh.CongestionControl.BLOCK if wait else zenoh.CongestionControl.DROP
        if topic.delivery == "latched":
            latched = zenoh.ext.declare_advanced_publisher(
                self.session,
                key,
                encoding=encoding,
                priority=priority,
                # one frozen reader must not stall the arm: what it misses it asks the cache for, as soon as it hears
                # how far the publisher is; so does who asked once, and whose answer was lost
                congestion_control=zenoh.CongestionControl.DROP,
                cache=zenoh.ext.CacheConfig(max_samples=1),
                publisher_detection=True,
                sample_miss_detection=zenoh.ext.MissDetectionConfig(
                    heartbeat=LATCHED_HEARTBEAT_S, sporadic_heartbeat=None
                ),
            )
            self._latched.append(latched)
            return Publisher(latched)
        return Publisher(
            self.session.declare_publisher(
                key, encoding=encoding, congestion_control=congestion, priority=priority, express=topic.express
            )
        )

    def subscriber(
        self,
        topic: Topic[M],
        name: str | None = None,
        *,
        keep: int | None = None,
        on_message: Callable[[Received[M]], None] | None = None,
    ) -> Subscriber[M]:
        """Declares a subscriber; ``name`` may be ``*``.

        Args:
            topic: the row of the table.
            name: what stands for ``{name}`` in its key.
            keep: how many samples wait to be taken (default: the table's ring).
            on_message: called with every sample by the reading thread, in order.
        """
        size = topic.ring if keep is None else keep
        key = topic.key_for(name)
        ring: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(size)
        inner = self._declare_subscriber(topic, key, ring)
        subscriber = Subscriber(topic, inner, size, self.counters, on_message)
        self._threads.append(subscriber.thread)
        return subscriber

    def newest(self, topic: Topic[M]) -> Newest[M]:
        """Declares a subscriber whose newest sample is there for whoever asks."""
        ring: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(_UNASKED)
        return Newest(topic, self._declare_subscriber(topic, topic.key_for(), ring), self.counters)

    def tap(
        self, topic: Topic[Any], take: Callable[[Sample], None], name: str | None = None, *, fifo: int = 64
    ) -> Callable[[], None]:
        """Hands over every sample of a key, serialised as it came, by a thread of its own; returns what ends that.

        Nothing is thrown away before ``take``: while that waits, the FIFO fills, and then everything that comes to this
        session waits as well. Use a session of its own for it. What does not have the topic's encoding is counted and
        left out.

        Args:
            topic: the row of the table.
            take: gets each sample, in order.
            name: what stands for ``{name}`` in its key; may be ``*``.
            fifo: samples that may wait for ``take``.
        """
        key, expected = topic.key_for(name), encoding_of(topic.message)
        channel: zenoh.handlers.FifoChannel[zenoh.Sample] = zenoh.handlers.FifoChannel(fifo)
        inner = self._declare_subscriber(topic, key, channel)

        def read() -> None:
            handler = inner.handler  # as in Subscriber; and the thread keeps the subscriber, whoever forgets it
            while True:
                try:
                    sample = handler.recv()
                except zenoh.ZError:
                    return
                if sample.kind != zenoh.SampleKind.PUT:
                    continue
                if str(sample.encoding) != expected:
                    self.counters.add(f"malformed_{topic.name}")
                    continue
                attachment = sample.attachment.to_bytes() if sample.attachment is not None else b""
                take(Sample(topic, topic.name_in(str(sample.key_expr)), sample.payload.to_bytes(), attachment))
                del sample  # frames in shared memory go back to their publisher

        thread = threading.Thread(target=read, name=f"tap {key}", daemon=True)
        self._threads.append(thread)
        thread.start()

        def end() -> None:
            inner.undeclare()
            thread.join(timeout=1.0)

        return end

    def presence(self, on_change: Callable[[str, bool], None] | None = None) -> Presence:
        """Watches which services are there."""
        presence = Presence(self.session, on_change)
        self._threads.append(presence.thread)
        return presence

    def serve(
        self, query: Query[Request, Response], handler: Callable[[Request], Response], name: str | None = None
    ) -> None:
        """Answers a query from a thread of its own, one after the other.

        ``handler`` raises :class:`ArmsightError` to refuse: its text goes to the caller.
        """
        inner = self.session.declare_queryable(query.key_for(name), zenoh.handlers.FifoChannel(64))

        def answer() -> None:
            while True:
                try:
                    asked = inner.recv()
                except zenoh.ZError:
                    return
                with asked:
                    self._answer(query, handler, asked)

        thread = threading.Thread(target=answer, name=f"serve {query.key}", daemon=True)
        self._threads.append(thread)
        thread.start()

    def query(
        self, query: Query[Request, Response], request: Request, name: str | None = None, *, timeout_s: float = 5.0
    ) -> Response:
        """Asks, and waits for the first answer.

        Raises:
            RefusedError: the service's own reason.
            NoReplyError: nobody answered in ``timeout_s``.
        """
        key = query.key_for(name)
        replies = self.session.get(
            key,
            payload=request.SerializeToString(),
            encoding=zenoh.Encoding(encoding_of(query.request)),
            timeout=timeout_s,
        )
        for reply in replies:
            if reply.ok is not None:
                response = query.response()
                try:
                    response.ParseFromString(reply.ok.payload.to_bytes())
                except DecodeError as error:
                    raise RefusedError(f"the answer on {key} is not a {query.response.DESCRIPTOR.full_name}") from error
                return response
            if reply.err is not None:
                text = reply.err.payload.to_bytes().decode(errors="replace")
                if text != "Timeout":
                    raise RefusedError(text)
        server = name or " or ".join(query.servers)
        raise NoReplyError(
            f"nobody answers {key} within {timeout_s:g} s: is {server} running, and may we ask it? "
            "(a router with certificates lets nobody ask without the right)"
        )

    def _declare_subscriber(self, topic: Topic[Any], key: str, channel: Any) -> Any:
        if topic.delivery != "latched":
            return self.session.declare_subscriber(key, channel)
        history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
        recovery = zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True)
        return zenoh.ext.declare_advanced_subscriber(self.session, key, channel, history=history, recovery=recovery)

    def _answer(self, query: Query[Request, Response], handler: Callable[[Request], Response], asked: Any) -> None:
        payload = asked.payload.to_bytes() if asked.payload is not None else b""
        try:
            if len(payload) > _MAX_QUERY_BYTES:
                raise DecodeError(f"{len(payload)} bytes are more than the {_MAX_QUERY_BYTES} allowed")
            request = query.request()
            request.ParseFromString(payload)
            response = handler(request)
        except DecodeError as error:
            self.counters.add(f"malformed_{query.name}")
            asked.reply_err(f"not a {query.request.DESCRIPTOR.full_name}: {error}")
        except ArmsightError as error:
            self.counters.add(f"refused_{query.name}")
            asked.reply_err(str(error))
        except Exception as error:
            self.counters.add(f"failed_{query.name}")
            log.exception("answering a query failed", extra={"key": query.key})
            asked.reply_err(f"internal error: {error}")
        else:
            encoding = zenoh.Encoding(encoding_of(query.response))
            asked.reply(asked.key_expr, response.SerializeToString(), encoding=encoding)


@contextmanager
def open_bus(session: zenoh.Session, counters: Counters | None = None) -> Iterator[Bus]:
    """A bus over a session that is closed on leaving."""
    bus = Bus(session, counters)
    try:
        with session:
            yield bus
    finally:
        bus.join()


def _decoded(topic: Topic[M], sample: zenoh.Sample, counters: Counters) -> M | None:
    if sample.kind != zenoh.SampleKind.PUT:
        return None
    message = topic.message()
    try:
        expected = encoding_of(topic.message)
        if str(sample.encoding) != expected:
            raise DecodeError(f"encoding {str(sample.encoding)!r} instead of {expected!r}")
        message.ParseFromString(sample.payload.to_bytes())
    except DecodeError as error:
        total = counters.add(f"malformed_{topic.name}")
        if total & (total - 1) == 0:  # the 1st, 2nd, 4th, 8th, …: a flood stays readable
            told = {"key": str(sample.key_expr), "reason": str(error), "total": total}
            log.warning("ignored a malformed message", extra=told)
        return None
    return message
