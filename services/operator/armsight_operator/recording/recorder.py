"""The recorder on the bus: every sample of the chosen keys into files, and what is lost is counted.

Frames have a session of their own: however long they wait, nothing else waits behind them. In lockstep, where nobody is
in a hurry, they wait for the disk; in real time what finds no room is lost, and the loop notices nothing.
"""

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from armsight.bus import Bus, Sample
from armsight.service import HealthReporter, serve_parameters
from armsight.topics import CAMERA_IMAGE
from armsight.v1.health_pb2 import HEALTH_STATUS_DEGRADED, HEALTH_STATUS_OK
from armsight.v1.sim_pb2 import CLOCK_MODE_LOCKSTEP, Clock
from armsight_operator.recording.backlog import Backlog
from armsight_operator.recording.selection import Selection
from armsight_operator.recording.series import Series

NAME = "recorder"
"""In ``health/{name}`` and ``{name}/parameters``."""

_PERIOD_S = 1.0
"""Of flushing and of health: what a crash takes is no more."""
_POLL_S = 0.1
_DRAIN_S = 1.0
"""At the end, for what came before it: a command that is asked to stop ends within two seconds."""
_LOCKSTEP_PATIENCE_S = 3.0
"""Sim's frames wait five seconds for a reader in lockstep, then it is cut off."""
_FRAMES_FIFO = 8
_LOSS_SHOWN_S = 10.0


@dataclass(frozen=True, slots=True)
class Report:
    """What a recording came to."""

    messages: int
    keys: int
    bytes: int
    lost: Mapping[str, int]


class Recorder:
    """From two places on the bus into a series of files."""

    def __init__(self, bus: Bus, frames: Bus, selection: Selection, series: Series, backlog: Backlog) -> None:
        """Listens from now on.

        Args:
            bus: a session of the recorder's own.
            frames: another, for pixels.
            selection: keys to record.
            series: where to write.
            backlog: what waits between the two.
        """
        self._bus, self._series, self._backlog = bus, series, backlog
        self._lockstep = False
        self._lost_before, self._lost_s = 0, -_LOSS_SHOWN_S
        self._ends: list[Callable[[], None]] = []
        for topic, name in selection.topics():
            take = self._take_frame if topic is CAMERA_IMAGE else self._take
            place = frames if topic is CAMERA_IMAGE else bus
            fifo = _FRAMES_FIFO if topic is CAMERA_IMAGE else 256
            self._ends.append(place.tap(topic, take, name, fifo=fifo))

    def run(self, stop: threading.Event, on_file: Callable[[str], None]) -> Report:
        """Writes until it is asked to stop.

        Args:
            stop: ends the recording.
            on_file: told the name of each file that is begun.

        Raises:
            FullError: no room.
        """
        serve_parameters(NAME, self._bus, {"file": str(self._series.path)})
        health = HealthReporter(NAME, self._bus)
        try:
            self._write_until(stop, health, on_file)
        finally:
            health.close()
        lost = self._backlog.lost
        self._series.finish("asked to stop", lost)
        totals = self._series.totals
        return Report(totals.messages.total(), len(totals.messages), totals.bytes, lost)

    def _write_until(self, stop: threading.Event, health: HealthReporter, on_file: Callable[[str], None]) -> None:
        due, path = time.monotonic(), None
        while not stop.is_set():
            self._write_one(_POLL_S)
            if path != self._series.path:
                path = self._series.path
                on_file(str(path))
            if time.monotonic() >= due:
                due = time.monotonic() + _PERIOD_S
                self._series.flush()
                self._report(health)
        for end in self._ends:
            end()
        until = time.monotonic() + _DRAIN_S
        while self._write_one(0.0) and time.monotonic() < until:
            pass
        self._backlog.give_up()

    def _write_one(self, timeout_s: float) -> bool:
        arrival = self._backlog.take(timeout_s)
        if arrival is None:
            return False
        message = self._series.write(arrival)
        if isinstance(message, Clock):
            self._lockstep = message.mode == CLOCK_MODE_LOCKSTEP
        return True

    def _take(self, sample: Sample) -> None:
        self._backlog.put(sample)

    def _take_frame(self, sample: Sample) -> None:
        self._backlog.put(sample, _LOCKSTEP_PATIENCE_S if self._lockstep else 0.0)

    def _report(self, health: HealthReporter) -> None:
        lost, now = sum(self._backlog.lost.values()), time.monotonic()
        if lost > self._lost_before:
            self._lost_before, self._lost_s = lost, now
        health.gauge("messages_written", self._series.totals.messages.total())
        health.gauge("messages_lost", lost)
        health.gauge("bytes_written", self._series.bytes)
        health.gauge("backlog_bytes", self._backlog.bytes)
        if now - self._lost_s < _LOSS_SHOWN_S:
            slow = f"{lost} messages lost: writing is too slow; leave keys out, or use a faster disk"
            health.report(HEALTH_STATUS_DEGRADED, slow)
        else:
            health.report(HEALTH_STATUS_OK, f"records to {self._series.path}")
