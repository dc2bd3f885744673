"""Settings that may be changed while a service runs: typed, bounded, described; set all together or not at all."""

import logging
import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from armsight.errors import ParameterError
from armsight.times import to_timestamp, wall_ns
from armsight.v1.parameters_pb2 import Parameter, Parameters, ParameterValue

log = logging.getLogger(__name__)

Value = bool | int | float | str


@dataclass(frozen=True, slots=True)
class Tunable:
    """One setting, of the kind of its value: a flag, a whole number, a number within bounds, one of some texts."""

    name: str
    description: str
    value: Value
    """With which the service starts."""
    unit: str = ""
    least: float = -math.inf
    most: float = math.inf
    choices: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuses what has no bounds, or starts outside of them: a mistake of ours."""
        if isinstance(self.value, str):
            bounded = self.value in self.choices
        else:
            bounded = isinstance(self.value, bool) or (
                math.isfinite(self.least) and math.isfinite(self.most) and self.least <= self.value <= self.most
            )
        if not bounded:
            raise ValueError(f"tunable {self.name} = {self.value!r} is not within bounds of its own")

    def checked(self, given: ParameterValue) -> Value:
        """A value that may be set.

        Raises:
            ParameterError: of another kind, not finite, out of bounds, or none of the choices.
        """
        kind = given.WhichOneof("kind")
        value: Value | None = getattr(given, kind) if kind else None
        if isinstance(self.value, bool):
            if not isinstance(value, bool):
                raise ParameterError(f"{self.name} is true or false")
        elif isinstance(self.value, str):
            if value not in self.choices:
                raise ParameterError(f"{self.name} is one of {', '.join(self.choices)}")
        else:
            value = self._checked_number(value)
        return value

    def _checked_number(self, value: Value | None) -> int | float:
        whole = isinstance(self.value, int)
        kind = "a whole number" if whole else "a number"
        bounds = f"{kind} within {self.least:g} to {self.most:g} {self.unit}".rstrip()
        if isinstance(value, bool | str) or value is None or (whole and not isinstance(value, int)):
            raise ParameterError(f"{self.name} is {bounds}")
        if not (math.isfinite(value) and self.least <= value <= self.most):
            raise ParameterError(f"{self.name} is {bounds}, not {value:g}")
        return value if whole else float(value)

    def message(self, value: Value) -> Parameter:
        """The setting with the value in force."""
        numeric = not isinstance(self.value, bool | str)
        return Parameter(
            name=self.name,
            description=self.description,
            unit=self.unit,
            value=value_message(value),
            least=self.least if numeric else 0.0,
            most=self.most if numeric else 0.0,
            choices=self.choices,
        )


def value_message(value: Value) -> ParameterValue:
    """A value as it goes over the bus."""
    if isinstance(value, bool):
        return ParameterValue(flag=value)
    if isinstance(value, str):
        return ParameterValue(text=value)
    return ParameterValue(whole=value) if isinstance(value, int) else ParameterValue(number=value)


class Tunables:
    """The settings of one service and their values in force."""

    def __init__(self, publish: Callable[[Parameters], None]) -> None:
        """None yet; each change goes to ``publish``."""
        self._publish = publish
        self._lock = threading.Lock()
        self._specs: dict[str, Tunable] = {}
        self._values: dict[str, Value] = {}
        self._apply: Callable[[Mapping[str, Value]], None] = lambda _: None

    def declare(self, specs: tuple[Tunable, ...], apply: Callable[[Mapping[str, Value]], None]) -> None:
        """Says what may be set.

        Args:
            specs: the settings.
            apply: makes all values, by name, the ones in force; raises an :class:`~armsight.errors.ArmsightError` where
                they can't be, and then has changed nothing.
        """
        with self._lock:
            self._specs = {spec.name: spec for spec in specs}
            self._values = {spec.name: spec.value for spec in specs}
            self._apply = apply
            self._publish(self._message())

    def set(self, given: Mapping[str, ParameterValue]) -> None:
        """Takes new values: all of them or, where one is refused, none.

        Raises:
            ParameterError: an unknown name or a value out of its bounds.
            ArmsightError: the service's own reason.
        """
        with self._lock:
            unknown = sorted(set(given) - set(self._specs))
            if unknown:
                known = ", ".join(self._specs) or "nothing"
                raise ParameterError(f"there is no parameter {unknown[0]!r} here: {known} may be set")
            values = self._values | {name: self._specs[name].checked(value) for name, value in given.items()}
            if values == self._values:
                return
            self._apply(values)
            self._values = values
            self._publish(self._message())
        log.info("parameters", extra={"set": {name: values[name] for name in given}})

    def messages(self) -> list[Parameter]:
        """All settings with their values in force."""
        with self._lock:
            return [spec.message(self._values[name]) for name, spec in self._specs.items()]

    def _message(self) -> Parameters:
        parameters = [spec.message(self._values[name]) for name, spec in self._specs.items()]
        return Parameters(time=to_timestamp(wall_ns()), parameters=parameters)
