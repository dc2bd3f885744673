"""The simulation's flags, checked before anything starts."""

import argparse
import datetime
import math
import os
from dataclasses import dataclass
from pathlib import Path

from armsight.errors import ConfigError
from armsight.service import add_service_arguments
from armsight.times import NS_PER_S, wall_ns
from armsight.topics import NAME
from armsight_sim.clock import WATCHDOG_S, ClockMode
from armsight_sim.targets import NONE, TARGETS, VISIBLE

AMBIENT_SWEEP = "sweep"
CAMERAS_VARIABLE = "ARMSIGHT_EXTERNAL_CAMERAS"
LIT, EMISSIVE = "lit", "emissive"
SAMPLES = (0, 4)
"""For each pixel: software GL gives no others."""
MIN_FPS, MAX_FPS = 15, 240
"""Each frame brings a command, and the next one may be late by a third of the watchdog's time."""
LEAST_SIDE_PX, MOST_SIDE_PX = 16, 1920
"""Of a camera's picture."""
MOST_PAINTERS = 16
MOST_NOISE = 50.0
"""Grey levels."""
# 2200: simulated time, counted on from here, stays in 64 bits for every reader
LATEST_START_NS = 7_258_118_400 * NS_PER_S


@dataclass(frozen=True, slots=True)
class Settings:
    """The configuration in force."""

    clock: ClockMode
    fps: int
    width: int
    height: int
    samples: int
    target: str
    start_ns: int
    ambient: float | None
    """Brightness of the ambient light; none: it sweeps slowly between 0.1 and 0.7."""
    noise: float
    emissive: bool
    """Whether markers shine by themselves: no shading, whatever the light."""
    seed: int
    model_error: float
    """Share by which the arm's links are longer than described."""
    pose: tuple[float, ...]
    model: Path | None = None
    """An MJCF or URDF; none: the arm of this package."""
    external_cameras: tuple[str, ...] = ()
    """Names of the cameras that somebody else brings; none: the simulation draws those of the model."""
    calibration: Path | None = None
    """A file of cameras and colours that is published in place of the model's."""
    painters: int | None = None
    """Processes that draw, 0 for the simulation's own; none: as many as help."""

    def __post_init__(self) -> None:
        """Refuses what can't work, saying what can."""
        if not MIN_FPS <= self.fps <= MAX_FPS:
            raise ConfigError(
                f"--fps {self.fps} is not within {MIN_FPS} to {MAX_FPS}: the arm holds when no command comes for "
                f"{WATCHDOG_S:g} s, and each frame brings one"
            )
        if not all(LEAST_SIDE_PX <= side <= MOST_SIDE_PX for side in (self.width, self.height)):
            raise ConfigError(
                f"--width {self.width} --height {self.height}: both must be within {LEAST_SIDE_PX} to {MOST_SIDE_PX}"
            )
        if self.ambient is not None and not 0.0 <= self.ambient <= 1.0:
            raise ConfigError(f"--ambient {self.ambient:g} is not within 0 to 1")
        if self.samples not in SAMPLES:
            raise ConfigError(f"samples {self.samples}: a pixel has {' or '.join(map(str, SAMPLES))}")
        if not 0.0 <= self.noise <= MOST_NOISE:
            raise ConfigError(f"--noise {self.noise:g} is not within 0 to {MOST_NOISE:g} grey levels")
        if self.painters is not None and not 0 <= self.painters <= MOST_PAINTERS:
            raise ConfigError(f"--painters {self.painters} is not within 0 to {MOST_PAINTERS}")
        if self.seed < 0:
            raise ConfigError(f"--seed {self.seed} is below 0")
        if not -0.05 <= self.model_error <= 0.05:
            raise ConfigError(f"--model-error {self.model_error:g} is not within -0.05 to 0.05")
        if self.external_cameras:
            self._check_external_cameras()

    def _check_external_cameras(self) -> None:
        given = f"--external-cameras {' '.join(self.external_cameras)}"
        if wrong := [name for name in self.external_cameras if not NAME.fullmatch(name)]:
            raise ConfigError(f"{given}: {wrong[0]!r} is no name: use letters, digits, '_', '-' and '.', at most 64")
        if len(set(self.external_cameras)) != len(self.external_cameras):
            raise ConfigError(f"{given}: a name is there twice")
        if len(self.external_cameras) < 2:
            raise ConfigError(f"{given}: name two cameras or more, one alone does not see how far a marker is")
        if self.clock is ClockMode.LOCKSTEP:
            raise ConfigError(f"{given}: cameras do not wait for answers as --clock lockstep does; use realtime")
        if self.target == VISIBLE:
            raise ConfigError(f"{given}: --target {VISIBLE} has to be drawn; choose another target")


def parse_settings(arguments: argparse.Namespace) -> Settings:
    """Settings from parsed flags.

    Raises:
        ConfigError: a value that can't be used.
    """
    return Settings(
        clock=ClockMode(arguments.clock),
        fps=arguments.fps,
        width=arguments.width,
        height=arguments.height,
        samples=arguments.samples,
        target=arguments.target,
        start_ns=_start_ns(arguments.start_time),
        ambient=_ambient(arguments.ambient),
        noise=arguments.noise,
        emissive=arguments.markers == EMISSIVE,
        seed=arguments.seed,
        model_error=arguments.model_error,
        pose=tuple(arguments.pose),
        model=arguments.model,
        external_cameras=tuple(arguments.external_cameras or os.environ.get(CAMERAS_VARIABLE, "").split()),
        calibration=arguments.calibration,
        painters=arguments.painters,
    )


def argument_parser() -> argparse.ArgumentParser:
    """All flags of armsight-sim."""
    parser = argparse.ArgumentParser(
        prog="armsight-sim", description="Simulates the arm: publishes camera frames, follows joint commands."
    )
    parser.add_argument(
        "--clock",
        choices=[mode.value for mode in ClockMode],
        default=ClockMode.REALTIME.value,
        help="realtime: frames by the wall clock; lockstep: wait for the answer to every frame (default: realtime)",
    )
    parser.add_argument(
        "--model", type=Path, metavar="FILE", help="MJCF or URDF of another arm: docs/own-arm.md (default: our own arm)"
    )
    parser.add_argument(
        "--external-cameras",
        nargs="+",
        metavar="NAME",
        default=[],
        help="draw no pictures: cameras of these names are brought by somebody else, such as armsight-camera; in real "
        f"time only (environment {CAMERAS_VARIABLE}, names with spaces between them)",
    )
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="FILE",
        help="publish this file's cameras and markers' colours in place of the model's: `armsight calibrate` makes it",
    )
    parser.add_argument("--fps", type=int, default=30, help="frames a second of simulated time, from 15 (default: 30)")
    parser.add_argument(
        "--width", type=int, default=800, help="pixels, of cameras whose model gives no resolution (default: 800)"
    )
    parser.add_argument("--height", type=int, default=800, help="as --width (default: 800)")
    parser.add_argument(
        "--samples", type=int, choices=SAMPLES, default=0, help="for each pixel; 4 is smoother and slower (default: 0)"
    )
    parser.add_argument(
        "--painters",
        type=int,
        metavar="N",
        help="processes that draw, the cameras shared among them; 0: the simulation draws by itself (default: in "
        "lockstep without a GPU one for each camera, as far as there are processors; else 0)",
    )
    parser.add_argument(
        "--target",
        choices=[NONE, *TARGETS],
        default=NONE,
        help="moving target to publish until somebody else publishes one (default: none)",
    )
    parser.add_argument("--start-time", metavar="TIME", help="RFC 3339 or Unix nanoseconds, for runs that repeat")
    parser.add_argument("--ambient", default="0.4", help="ambient light, 0 to 1, or 'sweep' (default: 0.4)")
    parser.add_argument(
        "--markers",
        choices=[LIT, EMISSIVE],
        default=LIT,
        help="lit: shaded like everything else; emissive: shine evenly by themselves (default: lit)",
    )
    parser.add_argument("--noise", type=float, default=0.0, help="standard deviation in grey levels (default: 0)")
    parser.add_argument("--seed", type=int, default=1, help="of the noise (default: 1)")
    parser.add_argument(
        "--model-error",
        type=float,
        default=0.0,
        help="share by which the links are longer than sim describes them, -0.05 to 0.05 (default: 0)",
    )
    parser.add_argument("--pose", type=float, nargs="+", metavar="RAD", default=[], help="start pose (default: zero)")
    add_service_arguments(parser)
    return parser


def _start_ns(text: str | None) -> int:
    if text is None:
        return wall_ns()
    start = _parse_time(text)
    if not 0 <= start <= LATEST_START_NS:
        raise ConfigError(f"--start-time {text!r} is out of range: from 1970 to 2200")
    return start


def _parse_time(text: str) -> int:
    if text.isascii() and text.isdigit():
        return int(text)
    try:
        time = datetime.datetime.fromisoformat(text)
    except ValueError as error:
        raise ConfigError(f"--start-time {text!r} is neither RFC 3339 nor nanoseconds: {error}") from error
    if time.tzinfo is None:
        raise ConfigError(f"--start-time {text!r} has no time zone: add Z for UTC")
    since = time - datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
    return (since.days * 86_400 + since.seconds) * NS_PER_S + since.microseconds * 1000


def _ambient(text: str) -> float | None:
    if text == AMBIENT_SWEEP:
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise ConfigError(f"--ambient {text!r} is neither a number nor {AMBIENT_SWEEP!r}")
    return value
