"""Runs the checks of one service on a bus, in order, one after the other."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from armsight.bus import Bus
from armsight.errors import ArmsightError, ConfigError
from armsight_operator.conformance import control, sim, vision
from armsight_operator.conformance.check import Check, NotApplicableError, Outcome, Result, UnfulfilledError
from armsight_operator.conformance.station import PRESENT_S, alive
from armsight_operator.errors import OperatorError


class OccupiedError(OperatorError, ConfigError):
    """A service that the suite would play is there already."""


class UnknownCheckError(OperatorError, ConfigError):
    """There is no check of that name."""


@dataclass(frozen=True, slots=True)
class Suite:
    """All that one kind of service is asked."""

    service: str
    plays: tuple[str, ...]
    """The services in whose place the suite speaks."""
    checks: tuple[Check[Any], ...]
    player: Callable[[Bus], Any]
    """Takes their place; has a ``station``, and ``settle`` and ``close``."""

    def chosen(self, names: Sequence[str]) -> tuple[Check[Any], ...]:
        """Those of these names, in the suite's order; all where there is no name.

        Raises:
            UnknownCheckError: one is not there.
        """
        known = [check.name for check in self.checks]
        for name in names:
            if name not in known:
                raise UnknownCheckError(f"no check {name!r} of {self.service}; there are {', '.join(known)}")
        return tuple(check for check in self.checks if not names or check.name in names)


_SUITES = {
    "vision": Suite("vision", ("sim",), vision.CHECKS, vision.Frames),
    "sim": Suite("sim", ("vision", "control"), sim.CHECKS, sim.Commander),
    "control": Suite("control", ("sim", "vision"), control.CHECKS, control.Loop),
}
PRESENT: Check[Any] = Check("present", "The service is on the bus, under this namespace.", "keys.md", lambda _: None)


def suite_of(service: str) -> Suite:
    """The suite for a kind of service."""
    return _SUITES[service]


def run(
    bus: Bus, suite: Suite, names: Sequence[str] = (), on_begin: Callable[[str], None] = lambda _: None
) -> Iterator[Result]:
    """Asks a service for everything, and says what came of each check as soon as it is known.

    Args:
        bus: where it is.
        suite: of the kind of service it is.
        names: only these checks.
        on_begin: gets a check's name when it begins.

    Raises:
        UnknownCheckError: a name that is none.
        OccupiedError: somebody is there whom the suite would play.
    """
    checks = suite.chosen(names)
    there = sorted(alive(bus.session) & set(suite.plays))
    if there:
        others = " and ".join(there)
        raise OccupiedError(
            f"{others} already there: the suite plays {' and '.join(suite.plays)} itself; stop {others}, or start "
            f"{suite.service} under another --namespace or on a router of its own"
        )
    player = suite.player(bus)
    try:
        on_begin(PRESENT.name)
        if not player.station.is_there():
            seen = f"nothing of {suite.service} for {PRESENT_S:g} s: is it running?"
            yield _result(PRESENT, Outcome.FAILED, seen, f"health or a token on health/{suite.service}")
            for check in checks:
                yield _result(check, Outcome.NOT_APPLICABLE, "nobody was there to ask")
            return
        player.settle()
        for check in checks:
            on_begin(check.name)
            yield _tried(check, player)
    finally:
        player.close()


def _tried(check: Check[Any], player: Any) -> Result:
    began = time.monotonic()
    try:
        check.run(player)
    except UnfulfilledError as fault:
        return _result(check, Outcome.FAILED, fault.seen, fault.expected, time.monotonic() - began)
    except NotApplicableError as reason:
        return _result(check, Outcome.NOT_APPLICABLE, str(reason), took_s=time.monotonic() - began)
    except ArmsightError as error:  # a question in passing that was not answered
        return _result(check, Outcome.FAILED, str(error), check.says, time.monotonic() - began)
    return _result(check, Outcome.PASSED, took_s=time.monotonic() - began)


def _result(check: Check[Any], outcome: Outcome, seen: str = "", expected: str = "", took_s: float = 0.0) -> Result:
    return Result(check.name, check.says, check.stands, outcome, seen, expected, took_s)
