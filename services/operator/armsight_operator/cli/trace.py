"""`armsight trace`: where the time of each frame goes."""

import json
import sys
import time
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armsight.stopping import stop_on_signals
from armsight_operator.cli.options import Connect, Namespace, ZenohConfig
from armsight_operator.errors import NoDataError, OperatorError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from armsight.session import SessionConfig
    from armsight_operator.trace import Frame, Statistics

_SILENCE_S = 5.0
_POLL_S = 0.1
_MOST_FRAMES = 100_000
"""In a file of trace events: the newest, an hour of them."""


def trace(
    frames: Annotated[int, typer.Option("--frames", "-n", help="End after so many frames; 0: never.", min=0)] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="A JSON object a frame, at the end one of them all.")] = False,
    chrome: Annotated[
        Path | None,
        typer.Option(
            "--chrome",
            metavar="FILE",
            help="Write trace events at the end, for ui.perfetto.dev or chrome://tracing.",
            show_default=False,
        ),
    ] = None,
    recordings: Annotated[
        list[Path] | None,
        typer.Option(
            "--from", metavar="FILE", help="Read a recording instead; may be given again.", show_default=False
        ),
    ] = None,
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Show where the time of each frame goes, stage by stage: from drawing to the command.

    In a terminal a table of the newest 1000 frames, elsewhere a line a frame. Ends with Ctrl-C or SIGTERM.

    Example: armsight trace --frames 300 --chrome frames.json

    Example: armsight trace --from run.mcap --json
    """
    from armsight_operator.cli.bus import configuration
    from armsight_operator.trace import Statistics
    from armsight_operator.trace.chrome import chrome_trace
    from armsight_operator.trace.show import frame_as_json, frame_as_line, summary_as_dict, summary_as_line

    statistics = Statistics()
    kept: deque[Frame] = deque(maxlen=_MOST_FRAMES if chrome is not None else 1)
    if chrome is not None:
        _check_writable(chrome)
    in_terminal = sys.stdout.isatty() and not as_json
    source = (
        _recorded(recordings, frames)
        if recordings
        else _frames(configuration(connect, namespace, zenoh_config), frames)
    )
    if in_terminal:
        _draw(source, statistics, kept)
    else:
        for frame in source:
            statistics.add(frame)
            kept.append(frame)
            print(frame_as_json(frame) if as_json else frame_as_line(frame), flush=True)
    if statistics.frames and not in_terminal:
        print(json.dumps({"summary": summary_as_dict(statistics)}) if as_json else summary_as_line(statistics))
    if chrome is not None and statistics.frames:
        try:
            chrome.write_text(chrome_trace(kept), encoding="utf-8")
        except OSError as error:
            raise OperatorError(f"can't write {chrome}: {error.strerror}") from error
        print(f"{len(kept)} frames in {chrome}", file=sys.stderr)


def _frames(config: "SessionConfig", count: int) -> "Iterator[Frame]":
    from armsight_operator.cli.bus import connected
    from armsight_operator.trace.listen import Listener

    with connected(config) as bus:
        stop = stop_on_signals()  # only now: nothing is waiting for a router any more
        listener, given, silent_s = Listener(bus), 0, 0.0
        while not stop.is_set() and (count == 0 or given < count):
            frame = listener.get(_POLL_S)
            if frame is not None:
                given, silent_s = given + 1, 0.0
                yield frame
                continue
            silent_s += _POLL_S
            if given == 0 and silent_s >= _SILENCE_S:
                raise NoDataError(f"no frame was answered for {_SILENCE_S:g} s: see `armsight status`")


def _recorded(files: list[Path], count: int) -> "Iterator[Frame]":
    from armsight_operator.recording.reader import Recording
    from armsight_operator.trace.recorded import recorded_frames

    recording, given = Recording(*files), 0
    for frame in recorded_frames(recording):
        given += 1
        yield frame
        if given == count:
            return
    for path, trouble in recording.troubles.items():
        print(f"{path}: {trouble}", file=sys.stderr)
    if given == 0:
        raise NoDataError("the recording has no frame that was answered: was control/status recorded?")


def _draw(source: "Iterator[Frame]", statistics: "Statistics", kept: "deque[Frame]") -> None:

    from rich.live import Live

    from armsight_operator.trace.show import picture

    with Live(picture(statistics), auto_refresh=False) as live:
        drawn_s = 0.0
        for frame in source:
            statistics.add(frame)
            kept.append(frame)
            now = time.monotonic()
            if now - drawn_s >= 0.25:
                live.update(picture(statistics), refresh=True)
                drawn_s = now
        live.update(picture(statistics), refresh=True)


def _check_writable(file: Path) -> None:
    """Said before, and not after an hour of frames."""
    from armsight.errors import ConfigError

    try:
        file.touch()
    except OSError as error:
        raise ConfigError(f"can't write {file}: {error.strerror}") from error
