"""What any service of one's own may do wrong, whichever it is: each is a base before the service's own class."""

import time
from typing import Any, ClassVar

from armsight.bus import Bus
from armsight.service import HealthReporter, serve_parameters
from armsight.v1.health_pb2 import HEALTH_STATUS_OK


class _Wrong:
    service: ClassVar[str]
    bus: Bus


class NoToken(_Wrong):
    def new_health(self) -> Any:
        return _WithoutToken(self.bus, self.service)


class RareHealth(_Wrong):
    def new_health(self) -> Any:
        return _OnceHealth(self.bus, self.service)


class TakesAnyParameter(_Wrong):
    def declare_parameters(self) -> None:
        tunables = serve_parameters(self.service, self.bus, {})
        tunables.set = lambda _: None  # type: ignore[method-assign, assignment]
        tunables.declare((), lambda _: None)


class _WithoutToken:
    """Health without the token that goes with it."""

    def __init__(self, bus: Bus, service: str) -> None:
        health = HealthReporter(service, bus)
        health.report(HEALTH_STATUS_OK)
        health._token.undeclare()  # type: ignore[no-untyped-call]


class _OnceHealth:
    """Holds the token, and says how it is only once in a while."""

    def __init__(self, bus: Bus, service: str) -> None:
        health = HealthReporter(service, bus)
        health.report(HEALTH_STATUS_OK)
        # every other message: too late by half
        publisher = health._publisher
        said: list[float] = []

        class Rare:
            def put(self, message: Any) -> None:
                if not said or time.monotonic() - said[-1] > 1.9:
                    said.append(time.monotonic())
                    publisher.put(message)

        health._publisher = Rare()  # type: ignore[assignment]
