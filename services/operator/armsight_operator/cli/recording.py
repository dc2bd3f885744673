"""`armsight recording info | recover | check`: what is in a file, whether it is whole, what the arm did in it."""

import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from armsight_operator.recording.info import Info

app = typer.Typer(
    help="Look into recordings, recover unfinished ones, check the motion in them.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

Files = Annotated[list[Path], typer.Argument(help="MCAP files of one recording.")]


@app.command()
def info(
    files: Files,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
) -> None:
    """Tell what a recording has in it and whether it is whole. Exit code 1 where it is not.

    Example: armsight recording info run.mcap
    """
    from armsight_operator.recording.info import info_of
    from armsight_operator.recording.reader import Recording

    found = info_of(Recording(*files))
    if as_json:
        print(json.dumps(found.as_json(), indent=2))
    else:
        _print(found)
    if not found.complete:
        raise typer.Exit(1)


@app.command()
def recover(
    files: Files,
    out: Annotated[Path, typer.Option(help="File to write.")],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a file that is there.")] = False,
) -> None:
    """Write what can be read of unfinished or damaged files to a whole one.

    Example: armsight recording recover run.mcap --out whole.mcap
    """
    from armsight_operator.recording.reader import Recording
    from armsight_operator.recording.recover import recover as write_anew

    recording = Recording(*files)
    count = write_anew(recording, out, overwrite=overwrite)
    for path, trouble in recording.troubles.items():
        print(f"{path}: {trouble}")
    print(f"{count} messages written to {out}")


@app.command()
def check(files: Files) -> None:
    """Hold the motion in a recording against what armsight guarantees. Exit code 1 where it does not, each time told.

    Example: armsight recording check run.mcap
    """
    from armsight_operator.recording import invariants
    from armsight_operator.recording.reader import Recording
    from armsight_operator.recording.timeline import WANTED, timeline_of

    found = invariants.check(timeline_of(Recording(*files).messages(WANTED)))
    for violation in found.violations:
        print(violation)
    resets = f", {found.resets} resets" if found.resets else ""
    deaf = f", {found.deaf_s:.1f} s of which commands may be missing" if found.deaf_s else ""
    print(f"{len(found.violations)} violations in {found.instants} instants of {found.lives} runs of sim{resets}{deaf}")
    if found.violations:
        raise typer.Exit(1)


def _print(info: "Info") -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("key", "message", "messages", "rate", "size", "lost", box=None, pad_edge=False)
    for name, key in sorted(info.keys.items()):
        rate = f"{key.rate_hz:.1f} Hz" if key.rate_hz else ""
        lost = str(key.lost) if key.lost else ""
        table.add_row(name, key.message, str(key.count), rate, f"{key.bytes / 1e6:.2f} MB", lost)
    console = Console(width=None if sys.stdout.isatty() else 160, highlight=False, soft_wrap=True)
    console.print(table)
    begun = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(info.begin_ns / 1e9)) if info.keys else "nothing in it"
    lost = f"{info.lost} lost" if info.lost else "none lost"
    console.print(f"{begun}, {info.seconds:.1f} s, {info.messages} messages, {lost}; {info.bytes / 1e6:.1f} MB on disk")
    for path in info.files:
        console.print(f"{path}: {info.troubles.get(path, 'whole')}")
