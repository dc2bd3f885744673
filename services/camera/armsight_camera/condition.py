"""How the cameras are, in one line for health. Nothing in here reads a clock."""

import datetime
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

from armsight.times import NS_PER_S
from armsight.v1.health_pb2 import (
    HEALTH_STATUS_DEGRADED,
    HEALTH_STATUS_OK,
    HEALTH_STATUS_WAITING,
    HealthStatus,
)
from armsight_camera.devices import Device

SILENT_AFTER_S = 2.0
"""A camera that is there and gives no frame for so long is told of."""

_RATE_FRAMES = 31


@dataclass(slots=True)
class Condition:
    """What is known of one camera now."""

    device: Device
    here: bool = False
    ended: bool = False
    since: str = ""
    """When it was lost, by the wall clock; empty: it never was there."""
    reason: str = "it is being opened"
    refused: tuple[str, ...] = ()
    last_s: float = 0.0
    """When its last frame came or it was opened, on the monotonic clock."""
    last_wall_ns: int = 0
    """The same by the wall clock, for a person."""
    times: deque[float] = field(default_factory=lambda: deque(maxlen=_RATE_FRAMES))

    def opened(self, refused: tuple[str, ...], now_s: float, wall_ns: int) -> None:
        """It is there."""
        self.here, self.refused, self.last_s, self.last_wall_ns = True, refused, now_s, wall_ns

    def took(self, at_s: float, now_s: float, wall_ns: int) -> None:
        """It gave a frame."""
        self.last_s, self.last_wall_ns = now_s, wall_ns
        self.times.append(at_s)

    def lost(self, reason: str, wall_ns: int) -> bool:
        """It is not there; returns whether it was before."""
        was, self.here, self.reason = self.here, False, reason
        if was:
            self.since = _clock_time(wall_ns)
        self.times.clear()
        return was

    def rate_hz(self) -> float:
        """Frames a second lately."""
        times = self.times
        return (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else 0.0


def health_of(conditions: Iterable[Condition], now_s: float, remark: str = "") -> tuple[HealthStatus, str]:
    """The status of all, and one line that says what is wrong and what is done about it.

    Args:
        conditions: of the cameras.
        now_s: on the monotonic clock.
        remark: what else is wrong.
    """
    cameras = tuple(conditions)
    if all(camera.ended for camera in cameras):
        return HEALTH_STATUS_OK, "all files were sent to their end: nothing more comes"
    wrong, missing = [], []
    for camera in cameras:
        if camera.ended:
            continue
        if not camera.here and camera.since:
            wrong.append(f"{camera.device} is gone since {camera.since}: {camera.reason}; it is tried again")
        elif not camera.here:
            missing.append(f"{camera.device} is not there yet: {camera.reason}; it is tried again")
        elif now_s - camera.last_s > SILENT_AFTER_S:
            wrong.append(f"{camera.device} is there, and gives no frames since {_clock_time(camera.last_wall_ns)}")
    nobody = not any(camera.here for camera in cameras)
    if wrong or remark or (missing and not nobody):
        return HEALTH_STATUS_DEGRADED, "; ".join([*wrong, *missing, *([remark] if remark else [])])
    if missing:
        return HEALTH_STATUS_WAITING, "; ".join(missing)
    if not any(camera.times for camera in cameras):
        return HEALTH_STATUS_WAITING, "waiting for the first frame"
    return HEALTH_STATUS_OK, "; ".join(
        f"{camera.device}: its driver did not take {', '.join(camera.refused)}" for camera in cameras if camera.refused
    )


def _clock_time(wall_ns: int) -> str:
    return datetime.datetime.fromtimestamp(wall_ns // NS_PER_S, datetime.UTC).strftime("%Y-%m-%d %H:%M:%SZ")
