"""The suite's place on the bus: what every service does the same way, health, parameters, its token."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

import zenoh
from google.protobuf.empty_pb2 import Empty

from armsight.bus import Bus, M, Received, Subscriber
from armsight.errors import NoReplyError, RefusedError
from armsight.service import HealthReporter
from armsight.topics import ASK_PARAMETERS, HEALTH, PARAMETERS, SET_PARAMETERS
from armsight.v1.health_pb2 import HEALTH_STATUS_OK, Health
from armsight.v1.parameters_pb2 import ParametersResponse, ParameterValue, SetParametersRequest
from armsight_operator.conformance import judge
from armsight_operator.conformance.check import Check, NotApplicableError, UnfulfilledError, require
from armsight_operator.recording.instants import instant_of

PRESENT_S = 4.0
"""Health comes every second: a service of which nothing is heard for so long does not run."""

ANSWER_S = 3.0
_COUNTED_S = 3.0
_COUNTERS = ("malformed", "refused")

DIRT = (b"", b"\x0a\xff\xff\xff\x0f", b"\xff" * 64, bytes(range(256)) * 20)
"""Bytes that are no message: cut off, of no known field, long."""


class Station:
    """Listens to one service, and plays others as far as their health."""

    def __init__(self, bus: Bus, service: str, plays: tuple[str, ...]) -> None:
        """Subscribes, and says that the played services are there."""
        self.bus, self.service = bus, service
        self._heard: list[tuple[float, Health]] = []
        self._arrived = threading.Condition()
        bus.subscriber(HEALTH, service, on_message=self._take)
        self._parameters = bus.subscriber(PARAMETERS, service)
        self._played = [HealthReporter(name, bus) for name in plays]
        for reporter in self._played:
            reporter.report(HEALTH_STATUS_OK, "played by armsight conformance")

    def close(self) -> None:
        """Takes the played services away."""
        for reporter in self._played:
            reporter.close()

    def is_there(self) -> bool:
        """Waits until anything is heard of the service."""
        until = time.monotonic() + PRESENT_S
        while not (self._heard or self.holds_token()):
            if time.monotonic() > until:
                return False
            time.sleep(0.05)
        return True

    def holds_token(self) -> bool:
        """Whether the service's liveliness token is there."""
        return self.service in alive(self.bus.session)

    def health(self) -> Health:
        """The next health that is published from now on."""
        with self._arrived:
            count = len(self._heard)
            if not self._arrived.wait_for(lambda: len(self._heard) > count, _COUNTED_S):
                raise UnfulfilledError(f"no health of {self.service} for {_COUNTED_S:g} s", "one a second")
            return self._heard[-1][1]

    def last_health(self) -> Health:
        """The newest health."""
        return self._heard[-1][1] if self._heard else self.health()

    def must_count(self, before: Health, least: int, what: str, words: tuple[str, ...] = _COUNTERS) -> None:
        """Waits until health counts what was refused, by this process still.

        Raises:
            UnfulfilledError: it does not, or the service was restarted.
        """
        until = time.monotonic() + _COUNTED_S
        while True:
            after = self.health()
            require(after.instance == before.instance, f"{self.service} was restarted by {what}", "that it goes on")
            found = judge.rose(before, after, words)
            if found >= least:
                return
            if time.monotonic() > until:
                named = " or ".join(f"`{word}`" for word in words)
                expected = f"{least}, in health's counters with {named} in their name"
                raise UnfulfilledError(f"{found} of {what} counted", expected)

    def until(self, condition: Callable[[], bool], timeout_s: float, seen: str, expected: str) -> None:
        """Waits for something.

        Raises:
            UnfulfilledError: it does not come about.
        """
        deadline = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > deadline:
                raise UnfulfilledError(f"{seen} within {timeout_s:g} s", expected)
            time.sleep(0.01)

    # --- checks of every service

    def token(self) -> None:
        """The liveliness token."""
        seen = f"no token on health/{self.service}"
        require(self.holds_token(), seen, f"a liveliness token on health/{self.service}, as long as it runs")

    def health_comes(self) -> None:
        """Health once a second, with its fields."""
        with self._arrived:
            first = len(self._heard)
            self._arrived.wait_for(lambda: len(self._heard) >= first + 3, 3.5 * judge.HEALTH_PERIOD_S)
            heard = self._heard[first:]
        judge.check_health(self.service, heard, time.time())

    def parameters(self) -> None:
        """What may be set is told, described, and refused beyond its bounds."""
        told = self._asked_parameters()
        require(told.json.startswith("{"), f"json {told.json[:40]!r}", "one JSON object")
        for parameter in told.parameters:
            judge.check_parameter(parameter)
        seen = f"nothing on parameters/{self.service}"
        self.until(lambda: self._parameters.latest is not None, ANSWER_S, seen, "the parameters, latched")
        latest = self._parameters.latest
        assert latest is not None
        named = [each.name for each in told.parameters]
        judge.check_names("latched parameters", [each.name for each in latest.message.parameters], named)
        self._must_refuse("conformance_no_such_parameter", ParameterValue(flag=True))
        for parameter in told.parameters:
            value = judge.beyond(parameter)
            if value is not None:
                self._must_refuse(parameter.name, value)
        kept = {each.name: each.value for each in self._asked_parameters().parameters}
        changed = [each.name for each in told.parameters if kept.get(each.name) != each.value]
        require(not changed, f"{', '.join(changed)} changed by what was refused", "the value before")
        if not told.parameters:
            raise NotApplicableError("it has no parameters that may be set; those that there are not it refuses")

    def malformed_query(self, key: str) -> None:
        """A query that is no message is refused with a text."""
        for reply in self.bus.session.get(key, payload=b"\xff\xff\xff", timeout=ANSWER_S):
            require(reply.err is not None, f"{key} took bytes that are no message", "a refusal")
            text = reply.err.payload.to_bytes() if reply.err is not None else b""
            require(text not in (b"", b"Timeout"), f"{key}: no text", "a refusal with a text")
            return
        raise UnfulfilledError(f"{key} did not answer", "a refusal with a text")

    def _asked_parameters(self) -> ParametersResponse:
        try:
            return self.bus.query(ASK_PARAMETERS, Empty(), self.service, timeout_s=ANSWER_S)
        except (NoReplyError, RefusedError) as error:
            raise UnfulfilledError(str(error), f"an answer on {self.service}/parameters") from error

    def _must_refuse(self, name: str, value: ParameterValue) -> None:
        request = SetParametersRequest(values={name: value})
        try:
            self.bus.query(SET_PARAMETERS, request, self.service, timeout_s=ANSWER_S)
        except RefusedError as refused:
            require(bool(str(refused)), f"{name} refused without a text", "a text that says what it may be")
        except NoReplyError as error:
            raise UnfulfilledError(str(error), f"a refusal on {self.service}/parameters/set") from error
        else:
            raise UnfulfilledError(f"{name} was set to {str(value).strip()}", "a refusal")

    def _take(self, received: Received[Health]) -> None:
        with self._arrived:
            self._heard.append((received.received_s, received.message))
            self._arrived.notify_all()


def alive(session: zenoh.Session) -> frozenset[str]:
    """Names of the services whose liveliness tokens are there now."""
    replies = session.liveliness().get(HEALTH.key_for("*"), timeout=1.0)
    return frozenset(HEALTH.name_in(str(reply.ok.key_expr)) for reply in replies if reply.ok is not None)


def drained(subscriber: Subscriber[M], quiet_s: float) -> list[M]:
    """All that waits, until nothing more comes for a while."""
    found: list[M] = []
    while (received := subscriber.recv(quiet_s)) is not None:
        found.append(received.message)
    return found


def of_instant(subscriber: Subscriber[M], capture_ns: int, timeout_s: float) -> M | None:
    """The message of an instant, past those of others; nothing within the time."""
    until = time.monotonic() + timeout_s
    while (left_s := until - time.monotonic()) > 0:
        received = subscriber.recv(left_s)
        if received is not None and instant_of(received.message) == capture_ns:
            return received.message
    return None


class _HasStation(Protocol):
    station: Station


def of_every_service(name: str) -> tuple[Check[Any], ...]:
    """What any service is asked, by its name at the beginning of a sentence."""

    def check(label: str, says: str, stands: str, ask: Callable[[Station], None]) -> Check[Any]:
        def run(player: _HasStation) -> None:
            ask(player.station)

        return Check(label, says, stands, run)

    return (
        check("token", f"{name} holds a liveliness token on the key of its health.", "keys.md", Station.token),
        check(
            "health",
            "Health comes every second, with all its fields, of one process.",
            "messages.md#health",
            Station.health_comes,
        ),
        check(
            "parameters",
            "What may be set is told and described, and a value out of bounds or an unknown name refused.",
            "messages.md#parameters",
            Station.parameters,
        ),
    )


@contextmanager
def refused(what: str) -> Iterator[None]:
    """A question within that must be refused, with a text.

    Raises:
        UnfulfilledError: it is answered, or nobody answers.
    """
    try:
        yield
    except RefusedError as refusal:
        require(bool(str(refusal)), f"{what} was refused without a text", "a text that says what is wrong")
    except NoReplyError as error:
        raise UnfulfilledError(str(error), "a refusal with a text") from error
    else:
        raise UnfulfilledError(f"{what} was taken", "a refusal with a text")
