"""What many robots take, computed from what was measured: `.venv/bin/python tools/scaling.py --robots 1000`.

A cell is one machine with the cameras of some robots, one vision for all of them and a router; frames stay in it. Its
router is linked to one at the center, and where those get too many, the center's routers to one above them. With
`--write` the tables of docs/scaling.md are made anew, with the assumptions below.
"""

import argparse
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "bench" / "results"
PAGE = ROOT / "docs" / "scaling.md"
BEGIN, END = "<!-- made by tools/scaling.py -->\n", "<!-- end of what is made -->\n"

FRAME_BYTES = 800 * 800 * 3
POOL_MB = 6 * 2**20 / 1e6
"""Of frames in shared memory, for each robot (proto/armsight/shared_memory.py)."""
SERIES = "30 Hz, shared memory, one vision for all"
CONTROL = "control --solver closed-form"
"""Whose figures count: with torch its memory is fifteen times as much."""
AT_CENTER, IN_CELL = "control and `armsight status` there", "control with the robot, `armsight status` there"

_ROW = re.compile(r"(?P<series>.+), (?P<robots>\d+) robots: (?P<figure>.+)")


@dataclass(frozen=True, slots=True)
class Assumptions:
    """What is taken for granted; every one is a flag."""

    robots: int = 1000
    rate_hz: float = 30.0
    cameras: int = 2
    cores: int = 16
    used: float = 0.5
    control: str = "cell"
    links: int = 50
    video: float = 0.0

    def __post_init__(self) -> None:
        """Refuses what makes no plan."""
        if min(self.robots, self.cores, self.cameras) < 1 or self.links < 2:
            raise ValueError("there is at least one robot, one camera and one core, and two links to a router")
        if not 0 < self.used <= 1 or not 0 <= self.video <= 1 or self.rate_hz <= 0:
            raise ValueError("shares are from 0 to 1, the rate is above 0")


EXPLAINED = {
    "robots": "how many there are",
    "rate_hz": "instants a second of each; processors and bytes grow with it",
    "cameras": "of each robot, of 800 x 800 pixels",
    "cores": "of a cell's machine, each as fast as one of those that were measured on",
    "used": "share of them that may be busy: with more, the slowest answers get slow",
    "control": "where it runs: cell, or center, on the far side of the link",
    "links": "that one router at the center takes; each is a connection and what is declared over it",
    "video": "share of the robots one of whose cameras somebody at the center looks at, at the full rate",
}


@dataclass(frozen=True, slots=True)
class Measured:
    """Of one robot at 30 Hz with two cameras."""

    vision_cores: float
    router_cores: float
    camera_cores: float
    """Of whoever puts the frames on the bus."""
    control_cores: float
    vision_mb: float
    router_mb: float
    """Of a router, however many robots it serves."""
    control_mb: float
    link_kb_s: float
    """Over the link, with control on its far side, and somebody there who looks at the robot's health and state."""
    status_kb_s: float
    """The same with control on the robot's side."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What that many robots take; memory in MB, rates in MB/s."""

    robots_a_cell: int
    cells: int
    routers: int
    links: int
    cell_cores: float
    """Busy ones of a full cell."""
    center_cores: float
    """Busy ones of all machines at the center: routers, and control if it is there."""
    cell_mb: float
    center_mb: float
    frames_mb_s: float
    """Within a full cell, from cameras to vision."""
    link_mb_s: float
    """From a full cell to the center and back."""
    center_mb_s: float
    """All links together."""


def plan(one: Measured, assumed: Assumptions) -> Plan:
    """The arithmetic.

    Raises:
        ValueError: not even one robot fits into a cell.
    """
    faster = assumed.rate_hz / 30.0
    # whoever draws, reads or measures frames does so for each of them
    a_robot = (one.vision_cores + one.router_cores + one.camera_cores) * faster * assumed.cameras / 2
    control = one.control_cores * faster
    in_cell = assumed.control == "cell"
    cell_robot = a_robot + control * in_cell
    per_cell = math.floor(assumed.cores * assumed.used / cell_robot + 1e-9)
    if per_cell < 1:
        raise ValueError(f"one robot takes {cell_robot:.2f} cores, more than the share of a machine that may be busy")
    per_cell = min(per_cell, assumed.robots)
    cells = math.ceil(assumed.robots / per_cell)
    levels = [math.ceil(cells / assumed.links)]
    while levels[-1] > 1:
        levels.append(math.ceil(levels[-1] / assumed.links))
    routers_at_center = sum(levels)
    frame_mb_s = FRAME_BYTES * assumed.rate_hz / 1e6
    told_kb_s = (one.status_kb_s if in_cell else one.link_kb_s) * faster
    link_mb_s = per_cell * (told_kb_s / 1000 + assumed.video * frame_mb_s)
    # what a router in a cell takes with frames in shared memory is what it takes to pass small messages
    passed = one.router_cores * faster * len(levels)
    return Plan(
        robots_a_cell=per_cell,
        cells=cells,
        routers=cells + routers_at_center,
        links=cells + routers_at_center - 1,
        cell_cores=per_cell * cell_robot,
        center_cores=assumed.robots * (passed + control * (not in_cell)),
        cell_mb=one.router_mb + per_cell * (one.vision_mb + POOL_MB + one.control_mb * in_cell),
        center_mb=routers_at_center * one.router_mb + assumed.robots * one.control_mb * (not in_cell),
        frames_mb_s=per_cell * assumed.cameras * frame_mb_s,
        link_mb_s=link_mb_s,
        center_mb_s=link_mb_s / per_cell * assumed.robots,
    )


def measured(
    robots: Sequence[Mapping[str, Any]], footprint: Sequence[Mapping[str, Any]], link: Sequence[Mapping[str, Any]]
) -> Measured:
    """One robot's share, of the most robots that were measured at once and kept up.

    Args:
        robots: rows of bench/results/robots.json.
        footprint: of footprint.json.
        link: of link.json.

    Raises:
        ValueError: a figure is missing: the benchmark has to run again.
    """

    def value(rows: Sequence[Mapping[str, Any]], name: str) -> float:
        for row in rows:
            if row["name"] == name:
                return float(row["value"])
        raise ValueError(f"no figure {name!r} in bench/results: run `make bench-robots bench-footprint bench-link`")

    def share(series: str, figure: str) -> float:
        most = max(1, round(value(robots, f"{series}: most robots that it keeps up with")))
        return value(robots, f"{series}, {most} robots: {figure}") / most / 100

    return Measured(
        vision_cores=share(SERIES, "vision"),
        router_cores=share(SERIES, "router"),
        camera_cores=share(SERIES, "senders"),
        control_cores=value(footprint, f"{CONTROL}: processors at 30 Hz") / 100,
        vision_mb=value(footprint, "vision: memory, PSS"),
        router_mb=value(footprint, "router: memory, PSS"),
        control_mb=value(footprint, f"{CONTROL}: memory, PSS"),
        link_kb_s=value(link, f"{AT_CENTER}: over the link"),
        status_kb_s=value(link, f"{IN_CELL}: over the link"),
    )


def plan_table(planned: Plan, assumed: Assumptions) -> str:
    """For a person."""
    where = "in the cell" if assumed.control == "cell" else "at the center"
    lines = [
        ("robots in a cell", f"{planned.robots_a_cell}"),
        ("cells, each with a vision and a router", f"{planned.cells}"),
        ("routers in all", f"{planned.routers}"),
        ("links between routers", f"{planned.links}"),
        ("busy cores of a cell", f"{planned.cell_cores:.1f} of {assumed.cores}"),
        ("busy cores at the center", f"{planned.center_cores:.1f}"),
        ("memory of a cell", f"{planned.cell_mb / 1000:.2f} GB"),
        ("memory at the center", f"{planned.center_mb / 1000:.2f} GB"),
        ("frames within a cell", f"{planned.frames_mb_s:.0f} MB/s"),
        ("over a cell's link", f"{planned.link_mb_s:.2f} MB/s"),
        ("over all links", f"{planned.center_mb_s:.0f} MB/s"),
    ]
    head = f"| {assumed.robots} robots, control {where} | |"
    return "\n".join([head, "|---|---|", *(f"| {name} | {text} |" for name, text in lines), ""])


def assumption_table() -> str:
    """The flags with their defaults."""
    lines = ["| flag | default | what it is |", "|---|---|---|"]
    for each in fields(Assumptions):
        default = f"{each.default:g}" if isinstance(each.default, float) else f"{each.default}"
        lines.append(f"| `--{each.name.replace('_', '-')}` | {default} | {EXPLAINED[each.name]} |")
    return "\n".join([*lines, ""])


def growth_table(robots: Sequence[Mapping[str, Any]]) -> str:
    """Of each series a line for every number of robots: processors a robot, beside the first one's, and its answers."""
    loads: dict[tuple[str, int], dict[str, float]] = {}
    for row in robots:
        if found := _ROW.fullmatch(row["name"]):
            key = found["series"], int(found["robots"])
            loads.setdefault(key, {})[found["figure"]] = float(row["value"])
    lines = [
        "| frames | robots | vision, each | beside one | router | control | senders | sent | answered | p50 | p99 |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for (series, count), told in loads.items():
        vision, alone = told["vision"] / count, loads[series, 1]["vision"]
        ends = [f"{told[f'answered after, p{percent}']:.1f} ms" for percent in (50, 99)]
        cells = (
            series,
            f"{count}",
            f"{vision:.1f} %",
            f"{vision / alone:.2f}",
            f"{told['router'] / count:.1f} %",
            f"{told['control'] / count:.1f} %" if "control" in told else "",
            f"{told['senders'] / count:.1f} %",
            f"{told['sent']:.0f} %",
            f"{told['answered']:.0f} %",
            *ends,
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


def rows_table(rows: Iterable[Mapping[str, Any]]) -> str:
    """Figures as they are."""
    lines = ["| | |", "|---|---|"]
    lines += [f"| {row['name']} | {row['value']:.4g} {row['unit']}{_beside(row)} |" for row in rows]
    return "\n".join([*lines, ""])


def sessions_table(sessions: Iterable[Mapping[str, Any]]) -> str:
    """A line for every number of sessions, a column for every figure."""
    told: dict[str, dict[str, str]] = {}
    for row in sessions:
        count, _, figure = row["name"].partition(" sessions: ")
        told.setdefault(count, {})[figure] = f"{row['value']:.3g} {row['unit']}"
    figures = list(next(iter(told.values())))
    lines = ["| sessions | " + " | ".join(figures) + " |", "|---" * (len(figures) + 1) + "|"]
    lines += ["| " + " | ".join([count, *each.values()]) + " |" for count, each in told.items()]
    return "\n".join([*lines, ""])


def _beside(row: Mapping[str, Any]) -> str:
    return f" {row['reference']}" if row["reference"] and row["ratio"] is None else ""


def footprint_table(footprint: Sequence[Mapping[str, Any]]) -> str:
    """A line for each process, then the images."""
    told: dict[str, dict[str, float]] = {}
    images = [row for row in footprint if row["name"].startswith("image ")]
    for row in footprint:
        if row not in images:
            name, _, figure = row["name"].partition(": ")
            told.setdefault(name, {})[figure] = float(row["value"])
    lines = ["| | start-up | memory, PSS | memory, RSS | of a core at 30 Hz |", "|---|---|---|---|---|"]
    for name, each in told.items():
        lines.append(
            f"| {name} | {each['start-up']:.2f} s | {each['memory, PSS']:.0f} MB | {each['memory, RSS']:.0f} MB"
            f" | {each['processors at 30 Hz']:.1f} % |"
        )
    text = "\n".join([*lines, ""])
    if images:
        sizes = ", ".join(f"{row['name'].removeprefix('image ')} {row['value']:.0f} MB" for row in images)
        text += f"\nImages: {sizes}.\n"
    return text


def page(before: str, results: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """The page with all that is made made anew."""
    head, _, rest = before.partition(BEGIN)
    tail = rest.partition(END)[2]
    robots, footprint, link = (results[name] for name in ("robots", "footprint", "link"))
    others = [row for row in robots if not _ROW.fullmatch(row["name"])]
    one = measured(robots, footprint, link)
    plans = [plan_table(plan(one, assumed), assumed) for assumed in (Assumptions(), Assumptions(control="center"))]
    parts = [
        "## Robots on one machine\n",
        growth_table(robots),
        rows_table(others),
        "## What each process takes\n",
        footprint_table(footprint),
        "## Over a link\n",
        rows_table(link),
        "## Sessions of one router\n",
        sessions_table(results["sessions"]),
        "## A thousand robots\n",
        *plans,
        "These are the assumptions, flags of `tools/scaling.py`:\n",
        assumption_table(),
    ]
    return head + BEGIN + "\n" + "\n".join(parts) + "\n" + END + tail


def read_results(folder: Path = RESULTS) -> dict[str, list[dict[str, Any]]]:
    """What the four benchmarks wrote."""
    return {
        name: json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
        for name in ("robots", "footprint", "link", "sessions")
    }


def main() -> None:
    """Prints the plan, or writes the page."""
    parser = argparse.ArgumentParser(description="What many robots take, computed from bench/results.")
    parser.add_argument("--write", action="store_true", help="make the tables of docs/scaling.md anew, and end")
    for each in fields(Assumptions):
        choices = ("cell", "center") if each.name == "control" else None
        parser.add_argument(
            f"--{each.name.replace('_', '-')}",
            type=type(each.default),
            default=each.default,
            choices=choices,
            help=f"{EXPLAINED[each.name]} (default: {each.default})",
        )
    arguments = vars(parser.parse_args())
    results = read_results()
    if arguments.pop("write"):
        PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), results), encoding="utf-8")
        return
    try:
        assumed = Assumptions(**arguments)
        planned = plan(measured(results["robots"], results["footprint"], results["link"]), assumed)
    except ValueError as error:
        parser.error(str(error))
    print(plan_table(planned, assumed), end="")


if __name__ == "__main__":
    main()
