"""What viewers want of the arm, asked for beside the page: the newest wish counts, and a stop waits for nothing."""

import logging
import threading
import time
from collections.abc import Callable, Mapping
from typing import TypeVar

from armsight import topics
from armsight.bus import Bus
from armsight.errors import ArmsightError
from armsight_operator.ask import (
    TARGET_PERIOD_S,
    ask_joints,
    ask_mode,
    ask_release,
    ask_stop,
    stopped_by,
    target_message,
)

log = logging.getLogger(__name__)

T = TypeVar("T")

SOURCE = "page"
"""Who stops, whichever viewer pressed the button."""

_STOP_TIMEOUT_S = 2.0

# Points may be lost on the way: the last one is repeated this long.
_TARGET_REPEATED_S = 1.0


class Hand:
    """Asks sim and control; what they refuse, or don't answer, is told in one line.

    Args:
        bus: where to ask.
        say: takes what went wrong, for the viewers; empty once that is over.
    """

    def __init__(self, bus: Bus, say: Callable[[str], None]) -> None:
        """Starts the thread that asks for motion."""
        self._bus = bus
        self._say = say
        self._targets = bus.publisher(topics.TARGET)
        self._changed = threading.Condition()
        self._wish: Callable[[], object] | None = None
        self._point: tuple[float, float, float] | None = None
        self._until_s = 0.0
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="hand", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stops the arm, now."""
        if self._try(lambda: ask_stop(self._bus, SOURCE, "stopped on the page", _STOP_TIMEOUT_S)) is None:
            self._say("The stop is NOT confirmed: sim does not answer. Is it running?")
        else:
            self._say("")

    def release(self) -> None:
        """Takes the page's own stop back, and says who else still stops the arm."""
        state = self._try(lambda: ask_release(self._bus, SOURCE, _STOP_TIMEOUT_S))
        if state is not None:
            others = stopped_by(state)
            self._say(f"still stopped by {', '.join(others)}" if others else "")

    def mode(self, name: str) -> None:
        """Sets a mode that needs no angles."""
        self._wish_for(lambda: ask_mode(self._bus, name))

    def joints(self, angles: Mapping[str, float]) -> None:
        """Moves the joints to angles in rad."""
        self._wish_for(lambda: ask_joints(self._bus, angles))

    def target(self, point: tuple[float, float, float], *, follow: bool) -> None:
        """Publishes a point of the world frame, metres.

        Args:
            point: where the tip is to be.
            follow: sets mode `track` first.
        """
        with self._changed:
            if follow:
                self._wish = lambda: ask_mode(self._bus, "track")
            self._point, self._until_s = point, time.monotonic() + _TARGET_REPEATED_S
            self._changed.notify()

    def close(self) -> None:
        """Ends the thread; what it waits for is left to its time limit."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join(timeout=0.2)

    def _wish_for(self, wish: Callable[[], object]) -> None:
        with self._changed:
            self._wish, self._point = wish, None
            self._changed.notify()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._wish or self._point)
                if self._closed:
                    return
                wish, self._wish = self._wish, None
                point = self._point
            if wish is not None:
                self._try(wish)
            if point is not None:
                self._publish(point)

    def _publish(self, point: tuple[float, float, float]) -> None:
        self._try(lambda: self._targets.put(target_message(*point, frame="world")))
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._wish or self._point != point, TARGET_PERIOD_S)
            if self._point == point and time.monotonic() >= self._until_s:
                self._point = None

    def _try(self, ask: Callable[[], T]) -> T | None:
        try:
            return ask()
        except ArmsightError as error:
            self._say(str(error))
        except Exception:
            log.exception("a viewer's wish failed")
            self._say("that failed: see the page's log")
        return None
