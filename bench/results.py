"""Benchmark results: written as JSON for programs, printed as a table for people."""

import json
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

RESULTS = Path(__file__).parent / "results"


@dataclass(frozen=True, slots=True)
class Result:
    """One figure beside the reference that was measured in the same run."""

    name: str
    value: float
    unit: str
    reference: str
    """What it is compared with; empty where it stands alone."""
    ratio: float | None
    """The figure divided by the reference's."""
    bar: str
    """What was promised, for a person; empty where nothing was."""
    holds: bool | None


def compare(
    name: str,
    value: float,
    unit: str,
    reference: str,
    reference_value: float,
    *,
    most: float | None = None,
    and_more: float = 0.0,
    least: float | None = None,
) -> Result:
    """A figure beside a reference, and what was promised of their ratio, if anything was.

    Args:
        name: of the figure.
        value: its value.
        unit: of both.
        reference: what it is compared with.
        reference_value: its value.
        most: what the ratio may be.
        and_more: what the figure may have beside that, in its unit.
        least: what the ratio must be.
    """
    ratio = value / reference_value
    if least is not None:
        return Result(name, value, unit, reference, ratio, f">= {least:g} x", ratio >= least)
    if most is None:
        return Result(name, value, unit, reference, ratio, "", None)
    text = f"<= {most:g} x" if most >= 1 else f"<= 1/{1 / most:g}"
    text += f" + {and_more:g} {unit}" if and_more else ""
    return Result(name, value, unit, reference, ratio, text, value <= most * reference_value + and_more)


def at_most(name: str, value: float, unit: str, bar: float) -> Result:
    """A figure with an upper bar."""
    return Result(name, value, unit, "", None, f"<= {bar:g} {unit}", value <= bar)


def at_least(name: str, value: float, unit: str, bar: float) -> Result:
    """A figure with a lower bar."""
    return Result(name, value, unit, "", None, f">= {bar:g} {unit}", value >= bar)


def between(name: str, value: float, unit: str, least: float, most: float) -> Result:
    """A figure with both."""
    return Result(name, value, unit, "", None, f"{least:g} to {most:g} {unit}".rstrip(), least <= value <= most)


def percentile(values: Sequence[float], percent: float) -> float:
    """The value that ``percent`` of all values do not exceed, interpolated.

    Raises:
        ValueError: no values.
    """
    if not values:
        raise ValueError("no values to take a percentile of")
    ordered = sorted(values)
    if len(ordered) == 1:
        return ordered[0]
    cuts = statistics.quantiles(ordered, n=1000, method="inclusive")
    return cuts[min(max(round(percent * 10) - 1, 0), 998)]


def publish(area: str, results: Sequence[Result]) -> None:
    """Writes ``results/{area}.json`` and prints the same as a table."""
    RESULTS.mkdir(exist_ok=True)
    file = RESULTS / f"{area}.json"
    file.write_text(json.dumps([_rounded(result) for result in results], indent=1) + "\n", encoding="utf-8")
    table = Table(title=f"bench: {area}")
    for column in ("figure", "value", "unit", "reference", "ratio", "bar", "holds"):
        table.add_column(column)
    for r in results:
        ratio = "" if r.ratio is None else f"1/{1 / r.ratio:.0f}" if 1e-6 < r.ratio < 0.1 else f"{r.ratio:.2f}"
        holds = "" if r.holds is None else ("yes" if r.holds else "NO")
        table.add_row(r.name, f"{r.value:.4g}", r.unit, r.reference, ratio, r.bar, holds)
    Console(width=160).print(table)


def _rounded(result: Result) -> dict[str, object]:
    # more digits than a benchmark has only make its changes harder to read
    return {key: float(f"{value:.4g}") if isinstance(value, float) else value for key, value in asdict(result).items()}
