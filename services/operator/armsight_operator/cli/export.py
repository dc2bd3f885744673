"""`armsight export`: a recording as tables."""

from pathlib import Path
from typing import Annotated

import typer


def export(
    files: Annotated[list[Path], typer.Argument(help="MCAP files of one recording.")],
    csv: Annotated[Path, typer.Option("--csv", metavar="FOLDER", help="Write CSV files there.", show_default=False)],
) -> None:
    """Write a recording's tables as CSV files: joints, positions, observations, command, status, health.

    Example: armsight export run.mcap --csv tables
    """
    from armsight_operator.recording.reader import Recording
    from armsight_operator.recording.tables import export as write_tables

    recording = Recording(*files)
    counts = write_tables(recording, csv)
    print(", ".join(f"{csv / table}.csv {count} rows" for table, count in counts.items()))
    for path, trouble in recording.troubles.items():
        print(f"{path}: {trouble}")
