"""The camera service's flags, checked before anything starts."""

import argparse
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from armsight.calibration import read_calibration_file
from armsight.errors import ConfigError
from armsight.service import add_service_arguments
from armsight_camera.calibrated import Calibrated, calibrated
from armsight_camera.devices import Device, Kind, parse_devices

MOST_FPS = 240.0
MOST_LATENCY_MS = 1000.0
MOST_SKEW_MS = 1000.0
DEFAULT_SKEW_MS = 10.0


@dataclass(frozen=True, slots=True)
class Wanted:
    """What a driver is asked for; none: as it likes."""

    width: int
    height: int
    fps: float | None = None
    exposure: float | None = None
    """In the driver's own unit (V4L2: 0.1 ms)."""
    gain: float | None = None
    """In the driver's own unit."""
    white_balance: float | None = None
    """Colour temperature in kelvin."""


@dataclass(frozen=True, slots=True)
class Settings:
    """The configuration in force."""

    devices: tuple[Device, ...]
    calibration: Path
    fps: float | None
    loop: bool
    latency_ms: float
    max_skew_ms: float
    wanted: Mapping[str, Wanted]
    """By camera."""
    known: Mapping[str, Calibrated] = field(repr=False)
    """By camera."""

    def __post_init__(self) -> None:
        """Refuses what can't work, saying what can."""
        if self.fps is not None and not 0.0 < self.fps <= MOST_FPS:
            raise ConfigError(f"--fps {self.fps:g} is not above 0 and up to {MOST_FPS:g}")
        if not 0.0 <= self.latency_ms <= MOST_LATENCY_MS:
            raise ConfigError(f"--latency-ms {self.latency_ms:g} is not within 0 to {MOST_LATENCY_MS:g}")
        if not 0.0 <= self.max_skew_ms <= MOST_SKEW_MS:
            raise ConfigError(f"--max-skew-ms {self.max_skew_ms:g} is not within 0 to {MOST_SKEW_MS:g}")

    def parameters(self) -> dict[str, object]:
        """What is answered on ``camera/parameters``."""
        return {
            "devices": {device.name: device.source for device in self.devices},
            "calibration": str(self.calibration),
            "fps": self.fps,
            "loop": self.loop,
            "latency_ms": self.latency_ms,
            "max_skew_ms": self.max_skew_ms,
        }


def parse_settings(arguments: argparse.Namespace) -> Settings:
    """Settings from parsed flags, and from the file of calibrations that they name.

    Raises:
        ConfigError: a value or a file that can't be used.
    """
    devices = parse_devices(arguments.device)
    if arguments.calibration is None:
        raise ConfigError(
            "say where the cameras' calibrations are: --calibration calibration.json (`armsight calibrate` makes it)"
        )
    content = read_calibration_file(arguments.calibration)
    known = {device.name: calibrated(content, device.name, arguments.calibration) for device in devices}
    _check_drivers(arguments, devices)
    return Settings(
        devices=devices,
        calibration=arguments.calibration,
        fps=arguments.fps,
        loop=arguments.loop,
        latency_ms=arguments.latency_ms,
        max_skew_ms=arguments.max_skew_ms,
        wanted={name: _wanted(arguments, name, camera) for name, camera in known.items()},
        known=known,
    )


def argument_parser() -> argparse.ArgumentParser:
    """All flags of armsight-camera."""
    parser = argparse.ArgumentParser(
        prog="armsight-camera",
        description="Brings cameras to the bus: their frames under capture times, their calibrations and poses.",
    )
    parser.add_argument(
        "--device",
        action="append",
        default=[],
        metavar="[NAME=]SOURCE",
        help="a number, /dev/video…, a URL, a video file or a folder of pictures (in the order of their names); given "
        "again for each camera. Names, as in the file of calibrations, default to 1, 2, …",
    )
    parser.add_argument(
        "--calibration", type=Path, metavar="FILE", help="the cameras' calibrations and poses: calibration.json"
    )
    parser.add_argument("--width", type=int, help="pixels, must be what was calibrated (default: that)")
    parser.add_argument("--height", type=int, help="as --width")
    parser.add_argument("--fps", type=float, help="asked of devices, and the pace of files (default: their own; 30)")
    parser.add_argument("--loop", action="store_true", help="begin files and folders again when they have ended")
    parser.add_argument("--exposure", type=float, help="fixed, in the driver's unit; V4L2's is 0.1 ms")
    parser.add_argument("--gain", type=float, help="fixed, in the driver's unit")
    parser.add_argument("--white-balance", type=float, metavar="K", help="fixed, colour temperature in kelvin")
    parser.add_argument(
        "--latency-ms", type=float, default=0.0, help="from exposure until a frame is grabbed here (default: 0)"
    )
    parser.add_argument(
        "--max-skew-ms",
        type=float,
        default=DEFAULT_SKEW_MS,
        help=f"frames of several cameras that are no farther apart share a capture time (default: {DEFAULT_SKEW_MS:g})",
    )
    add_service_arguments(parser)
    return parser


def _check_drivers(arguments: argparse.Namespace, devices: tuple[Device, ...]) -> None:
    controls = {
        "--exposure": arguments.exposure,
        "--gain": arguments.gain,
        "--white-balance": arguments.white_balance,
    }
    given = {flag: value for flag, value in controls.items() if value is not None}
    for flag, value in given.items():
        if not math.isfinite(value):
            raise ConfigError(f"{flag} {value} is not a finite number")
    if given and not any(device.kind is Kind.DEVICE for device in devices):
        raise ConfigError(f"{', '.join(given)}: there is no device here that could be asked for it")


def _wanted(arguments: argparse.Namespace, name: str, camera: Calibrated) -> Wanted:
    width, height = camera.size
    asked = (arguments.width or width, arguments.height or height)
    if asked != (width, height):
        raise ConfigError(
            f"--width {asked[0]} --height {asked[1]}: camera {name} was calibrated at {width} x {height}; leave them "
            "out, or calibrate it at this size (`armsight calibrate intrinsics`)"
        )
    return Wanted(width, height, arguments.fps, arguments.exposure, arguments.gain, arguments.white_balance)
