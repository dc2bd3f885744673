"""`armsight record`: what goes over the bus, as an MCAP file."""

import argparse
import threading
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armsight.stopping import stop_on_signals
from armsight_operator.cli.options import Connect, Namespace, ZenohConfig

if TYPE_CHECKING:
    from armsight.session import SessionConfig
    from armsight_operator.recording.recorder import Report
    from armsight_operator.recording.selection import Selection
    from armsight_operator.recording.series import Limits

_MB = 1_000_000


def record(
    file: Annotated[
        Path | None,
        typer.Argument(help="File to make, such as run.mcap; in a folder that exists it is named by the time."),
    ] = None,
    keys: Annotated[
        list[str] | None,
        typer.Argument(
            help="Keys of `armsight topics list`; * stands for any chunk. [default: all]", show_default=False
        ),
    ] = None,
    without: Annotated[
        list[str] | None,
        typer.Option("--without", metavar="KEY", help="Leave a key out; may be given again.", show_default=False),
    ] = None,
    split_mb: Annotated[
        float | None, typer.Option("--split-mb", help="Go on in another file after so many MB.", min=1)
    ] = None,
    split_s: Annotated[
        float | None, typer.Option("--split-s", help="Go on in another file after so many seconds.", min=1)
    ] = None,
    seconds: Annotated[float, typer.Option(help="End after so many; 0: on Ctrl-C.", min=0)] = 0.0,
    compression: Annotated[str, typer.Option(help="zstd, lz4 or none.")] = "zstd",
    backlog_mb: Annotated[
        float, typer.Option("--backlog-mb", help="Memory for frames that wait for the disk, in MB.", min=1)
    ] = 128.0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace files that are there.")] = False,
    health: Annotated[bool, typer.Option("--health", help="Only ask whether a recorder runs.")] = False,
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Record what goes over the bus to an MCAP file until Ctrl-C; Foxglove, Lichtblick and Rerun open it.

    A crash takes the last second, no more. Exit code 1 where the disk gets full.

    Example: armsight record run.mcap

    Example: armsight record tables.mcap --without 'camera/*/image'

    Example: armsight record long.mcap --split-mb 1000

    Example: armsight record arm.mcap 'joints/*' control/status target
    """
    from armsight.errors import ConfigError
    from armsight_operator.cli.bus import configuration
    from armsight_operator.recording.mcap_file import COMPRESSIONS
    from armsight_operator.recording.selection import select
    from armsight_operator.recording.series import Limits

    if health:
        _probe(connect, namespace, zenoh_config)
        return
    if file is None:
        raise ConfigError("no file named to record to; for example `armsight record run.mcap`")
    if compression not in COMPRESSIONS:
        raise ConfigError(f"--compression {compression!r} is none of {', '.join(COMPRESSIONS)}")
    if not file.is_dir() and file.suffix != ".mcap":
        raise ConfigError(f"{file} does not end with .mcap: keys come after the file")
    _run(
        configuration(connect, namespace, zenoh_config, shared_memory="read"),
        file,
        select(keys or (), without or ()),
        Limits(None if split_mb is None else round(split_mb * _MB), split_s),
        seconds=seconds,
        compression=compression,
        backlog_bytes=round(backlog_mb * _MB),
        overwrite=overwrite,
    )


def _run(
    config: "SessionConfig",
    file: Path,
    selection: "Selection",
    limits: "Limits",
    *,
    seconds: float,
    compression: str,
    backlog_bytes: int,
    overwrite: bool,
) -> None:
    from armsight.logs import set_up_logging
    from armsight_operator.cli.bus import wait_connected
    from armsight_operator.recording.backlog import Backlog
    from armsight_operator.recording.recorder import NAME, Recorder
    from armsight_operator.recording.series import Series

    set_up_logging(NAME, "warning")
    stop = stop_on_signals()
    with ExitStack() as places:
        bus = places.enter_context(wait_connected(config, stop))
        frames = places.enter_context(wait_connected(config, stop))
        if bus is None or frames is None:
            return
        about = {"namespace": config.namespace, "keys": " ".join(map(str, selection.wanted))}
        series = Series(file, limits, about, compression, overwrite=overwrite, counters=bus.counters)
        recorder = Recorder(bus, frames, selection, series, Backlog(backlog_bytes))
        if seconds > 0:
            timer = threading.Timer(seconds, stop.set)
            timer.daemon = True
            timer.start()
        report = recorder.run(stop, lambda path: print(f"records to {path}", flush=True))
    print(_summary(report), flush=True)


def _summary(report: "Report") -> str:
    lost = ", ".join(f"{count} of {key}" for key, count in sorted(report.lost.items()))
    return (
        f"recorded {report.messages} messages of {report.keys} keys, {report.bytes / _MB:.1f} MB; lost {lost or 'none'}"
    )


def _probe(connect: list[str] | None, namespace: str | None, zenoh_config: Path | None) -> None:
    from armsight.service import probe
    from armsight_operator.recording.recorder import NAME

    flags = argparse.Namespace(connect=connect, namespace=namespace, zenoh_config=zenoh_config)
    if probe(NAME, flags):
        raise typer.Exit(1)
    print("a recorder runs")
