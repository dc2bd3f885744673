"""What to do when a process of the stack dies: say so, and start it again after a while."""

import signal
import time
from collections.abc import Callable
from dataclasses import dataclass

from armsight.service import EXIT_CONFIG
from armsight_operator.errors import OperatorError
from armsight_operator.stack.backoff import Backoff
from armsight_operator.stack.stack import Stack


@dataclass(frozen=True, slots=True)
class Death:
    """A process ended without having been asked to."""

    name: str
    code: int
    """Exit code; negative: the signal that killed it."""
    lived_s: float
    restart_in_s: float | None
    """Nothing: it stays down."""
    last_line: str
    """The last line of its log in that life."""

    def __str__(self) -> str:
        """One line for a person."""
        how = f"was killed by {_signal_name(-self.code)}" if self.code < 0 else f"ended with exit code {self.code}"
        if self.restart_in_s is not None:
            then = f"starting it again in {self.restart_in_s:g} s"
        elif self.code == EXIT_CONFIG:
            then = "starting it again would not help"
        else:
            then = "it stays down"
        said = f": {self.last_line}" if self.last_line else ""
        return f"{self.name} {how} after {self.lived_s:.1f} s{said}; {then}"

    @property
    def hopeless(self) -> bool:
        """It can't use its configuration: starting it again changes nothing."""
        return self.code == EXIT_CONFIG


class Supervisor:
    """Watches a stack's processes; :meth:`poll` does everything, in the caller's thread."""

    def __init__(
        self,
        stack: Stack,
        *,
        restart: bool = True,
        backoff: Backoff | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Takes a stack whose processes are started already, or will be."""
        self._stack = stack
        self._restart = restart
        self._backoff = backoff or Backoff()
        self._clock = clock
        self._delays: dict[str, float] = {}
        self._due: dict[str, float] = {}
        self._down: set[str] = set()

    def poll(self) -> list[Death]:
        """Starts again what is due; returns the deaths since the last call."""
        for name in [name for name, due in self._due.items() if self._clock() >= due]:
            del self._due[name]
            self._start(name)
        return [death for name in self._stack.names if (death := self._death(name)) is not None]

    def _start(self, name: str) -> None:
        try:
            self._stack.start(name)
        except OperatorError:  # the port is taken for the moment, or a rebuild has the executable
            self._delay(name, 0.0)

    def _death(self, name: str) -> Death | None:
        process = self._stack.process(name)
        if process is None or name in self._due or name in self._down:
            return None
        code = process.poll()
        if code is None:
            return None
        lived = self._clock() - process.started_s
        delay = None
        if self._restart and code != EXIT_CONFIG:
            delay = self._delay(name, lived)
        else:
            self._down.add(name)
        return Death(name, code, lived, delay, process.last_line())

    def _delay(self, name: str, lived_s: float) -> float:
        delay = self._backoff.delay(self._delays.get(name), lived_s)
        self._delays[name] = delay
        self._due[name] = self._clock() + delay
        return delay


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
