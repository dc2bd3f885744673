"""A thread for each camera: opens it, takes frame after frame, opens it again when it is gone.

A driver may block for as long as it likes: nobody waits for these threads.
"""

import logging
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import cv2

from armsight.counters import Counters
from armsight.times import NS_PER_S
from armsight_camera.devices import Device
from armsight_camera.errors import SizeError, SourceError
from armsight_camera.pace import Pace
from armsight_camera.settings import Wanted
from armsight_camera.source import Image, Source

log = logging.getLogger(__name__)

FIRST_RETRY_S, LONGEST_RETRY_S = 0.5, 5.0
_MOST_UNDECODED = 30
"""In a row: then it is opened anew."""

_ROOM_POLL_S = 0.1

Opener = Callable[[Device, Wanted], Source]


@dataclass(frozen=True, slots=True)
class Frame:
    """One picture of one camera."""

    camera: str
    grabbed_ns: int
    """On the monotonic clock."""
    image: Image


@dataclass(frozen=True, slots=True)
class Opened:
    """A camera is there."""

    camera: str
    refused: tuple[str, ...]
    """What its driver did not take."""


@dataclass(frozen=True, slots=True)
class Lost:
    """A camera is not there, or no longer; it is tried again."""

    camera: str
    reason: str


@dataclass(frozen=True, slots=True)
class Unfit:
    """A camera that was there from the start has pictures of another size than its calibration."""

    camera: str
    error: SizeError


@dataclass(frozen=True, slots=True)
class Ended:
    """A file has come to its end."""

    camera: str


Event = Frame | Opened | Lost | Unfit | Ended


class Capture:
    """Takes the pictures of one device and puts what happens into a queue."""

    def __init__(
        self,
        device: Device,
        wanted: Wanted,
        opener: Opener,
        *,
        events: "queue.Queue[Event]",
        pace: Pace,
        counters: Counters,
        stop: threading.Event,
        loop: bool,
    ) -> None:
        """Starts.

        Args:
            device: whose pictures.
            wanted: what its driver is asked for.
            opener: opens it.
            events: gets what happens; a device's frames that find no room are counted and dropped.
            pace: of files.
            counters: totals for health.
            stop: ends it, once the driver lets go.
            loop: whether a file begins again.
        """
        self._device, self._wanted, self._opener = device, wanted, opener
        self._events, self._pace, self._counters = events, pace, counters
        self._stop, self._loop = stop, loop
        self._number = 0
        """Of the next picture of a file."""
        self._delivers = False
        self.thread = threading.Thread(target=self._run, name=f"camera {device.name}", daemon=True)
        self.thread.start()

    def _run(self) -> None:
        retry_s, attempt = FIRST_RETRY_S, 0
        while not self._stop.is_set():
            self._delivers = False
            try:
                ended = self._one_life(first=attempt == 0)
            except SizeError as error:
                if attempt == 0 and not self._delivers:
                    self._say(Unfit(self._device.name, error))
                    return
                reason = str(error)
            except (SourceError, cv2.error) as error:
                reason = str(error)
            except Exception as error:
                log.exception("taking pictures failed", extra={"camera": self._device.name})
                self._counters.add("failed_capture")
                reason = f"internal error: {error}"
            else:
                if ended and self._loop and self._delivers:
                    continue
                if ended:
                    self._say(Ended(self._device.name))
                    return
                reason = "it gives no more frames"
            attempt += 1
            self._say(Lost(self._device.name, reason))
            retry_s = FIRST_RETRY_S if self._delivers else min(2 * retry_s, LONGEST_RETRY_S)
            self._stop.wait(retry_s)

    def _one_life(self, *, first: bool) -> bool:
        """From opening to the last frame; returns whether it was a file, and ended."""
        try:
            source = self._opener(self._device, self._wanted)
        finally:
            if first and self._device.ends:
                self._pace.opened()
        try:
            self._check(source.size())
            self._say(Opened(self._device.name, source.refused))
            undecoded = 0
            while not self._stop.is_set():
                grabbed_ns = self._grab(source)
                if grabbed_ns is None:
                    return self._device.ends
                image = self._retrieve(source)
                undecoded = undecoded + 1 if image is None else 0
                if undecoded >= _MOST_UNDECODED and not self._device.ends:
                    raise SourceError(f"{undecoded} frames one after the other can't be decoded")
                if image is not None:
                    self._hand_over(Frame(self._device.name, grabbed_ns, image))
            return False
        finally:
            source.close()

    def _grab(self, source: Source) -> int | None:
        """The time of the next frame, or nothing at the end."""
        if source.fps is None:
            return time.monotonic_ns() if source.grab() else None
        while not self._pace.begun.wait(_ROOM_POLL_S):
            if self._stop.is_set():
                return None
        due_ns = self._pace.due_ns(source.fps, self._number, time.monotonic_ns())
        self._stop.wait(max(0.0, (due_ns - time.monotonic_ns()) / NS_PER_S))
        if not source.grab():
            return None
        self._number += 1
        return due_ns

    def _retrieve(self, source: Source) -> Image | None:
        try:
            image = source.retrieve()
        except cv2.error as error:
            log.debug("a frame can't be decoded", extra={"camera": self._device.name, "reason": str(error)})
            image = None
        if image is None:
            self._counters.add("frames_undecoded")
        return image

    def _hand_over(self, frame: Frame) -> None:
        height, width, _ = frame.image.shape
        if (width, height) != (self._wanted.width, self._wanted.height):
            self._counters.add("frames_of_another_size")
            if not self._device.ends:
                self._check((width, height))
            return
        self._delivers = True
        if self._device.ends:
            self._say(frame)
            return
        try:
            self._events.put_nowait(frame)
        except queue.Full:
            self._counters.add("frames_dropped")

    def _say(self, event: Event) -> None:
        """Waits for room."""
        while not self._stop.is_set():
            try:
                self._events.put(event, timeout=_ROOM_POLL_S)
            except queue.Full:
                continue
            return

    def _check(self, size: tuple[int, int] | None) -> None:
        check_size(self._device, self._wanted, size)


def check_size(device: Device, wanted: Wanted, size: tuple[int, int] | None) -> None:
    """Whether pictures have the size that was calibrated, as far as the source says it.

    Raises:
        SizeError: they haven't.
    """
    if size is not None and size != (wanted.width, wanted.height):
        raise SizeError(
            f"{device} has pictures of {size[0]} x {size[1]}, calibrated were {wanted.width} x {wanted.height}: choose "
            "its calibration, or calibrate it at this size (`armsight calibrate intrinsics`)"
        )
