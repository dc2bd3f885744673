"""`armsight describe`: whether a model of an arm can be used, and what everybody will know of it."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armsight.errors import ConfigError

if TYPE_CHECKING:
    from rich.table import Table


def describe(
    file: Annotated[Path, typer.Argument(metavar="MODEL", help="MJCF, or URDF, of an arm.")],
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object: findings, and the description as it goes over the bus.")
    ] = False,
) -> None:
    """Check a model of another arm, and print what it describes.

    Says everything that is missing or wrong at once, each with what to do. Exit code 1 where the arm can't be used as
    it is, 2 where there is no model that can be read; warnings alone are no failure.

    Example: armsight describe services/sim/armsight_sim/models/five.xml
    """
    said = _ask(file)
    if "unreadable" in said:
        raise ConfigError(said["unreadable"])
    if as_json:
        print(json.dumps(said))
    else:
        _print(file, said)
    if "description" not in said:
        raise typer.Exit(1)


def _ask(file: Path) -> dict[str, Any]:
    """What sim says, in a process of its own: MuJoCo does not belong into the operator's, and may be absent."""
    import importlib.util

    from armsight_operator.doctor.facts import ask

    if importlib.util.find_spec("armsight_sim") is None:
        raise ConfigError("sim is not installed here, which reads models: run this where `armsight-sim` is")
    answer = ask([sys.executable, "-m", "armsight_sim.describe", str(file)], 60.0)
    try:
        said: dict[str, Any] = json.loads(answer.out)
    except ValueError:
        raise ConfigError(f"sim can't look at {file}: {answer.last_line}") from None
    return said


def _print(file: Path, said: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.text import Text

    console = Console(soft_wrap=True, highlight=False, no_color=not sys.stdout.isatty())
    for finding in said["findings"]:
        level, style = ("wrong", "bold red") if finding["breaks"] else ("warning", "yellow")
        console.print(Text.assemble((f"{level:8}", style), f" {finding['what']}; {finding['mend']}"))
    if "description" not in said:
        wrong = sum(finding["breaks"] for finding in said["findings"])
        console.print(f"{file}: {wrong} to mend before the arm can be used")
        return
    description = said["description"]
    console.print(f"{description.get('name') or file}: can be used; all of it in the base frame, metres and radians")
    for table in (_joints(description), _points(description), _cameras(description, said["resolutions"])):
        console.print(table)


def _joints(description: dict[str, Any]) -> "Table":
    table = _table("joint", "origin in the last one", "axis", "from", "to", "rad/s")
    for joint in description["joints"]:
        limits = (f"{joint.get(key, 0.0):.3f}" for key in ("lower_rad", "upper_rad"))
        speed = f"{joint['max_speed_rad_s']:g}"
        table.add_row(joint["name"], _vector(joint["origin"]), _vector(joint["axis"]), *limits, speed)
    return table


def _points(description: dict[str, Any]) -> "Table":
    table = _table("marker", "on", "at", "radius", "colour")
    for marker in description["markers"]:
        centre, color = marker["centre"], marker["color"]
        channels = ", ".join(f"{color.get(channel, 0.0):g}" for channel in ("red", "green", "blue"))
        at = _vector(centre["position"])
        table.add_row(marker["name"], centre.get("joint", "base"), at, f"{marker['radius_m']:g}", channels)
    tip = description["tip"]
    table.add_row("(tip)", tip.get("joint", "base"), _vector(tip["position"]), "", "")
    return table


def _cameras(description: dict[str, Any], resolutions: dict[str, list[int]]) -> "Table":
    table = _table("camera", "pixels")
    for name in description["cameras"]:
        size = resolutions.get(name)
        table.add_row(name, f"{size[0]} x {size[1]}" if size else "--width x --height")
    return table


def _table(*columns: str) -> "Table":
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        table.add_column(column, no_wrap=True)
    return table


def _vector(vector: dict[str, float]) -> str:
    return ", ".join(f"{round(vector.get(axis, 0.0), 4) + 0.0:g}" for axis in "xyz")
