"""A trace for people and for pipes."""

import json
from typing import TYPE_CHECKING, Any

from armsight_operator.trace.stages import STAGES, TOTAL, Frame
from armsight_operator.trace.statistics import Statistics, Summary

if TYPE_CHECKING:
    from rich.console import RenderableType

_BAR = 24
"""Characters for the longest way of a frame that is shown."""


def frame_as_json(frame: Frame) -> str:
    """One line for each frame: milliseconds a stage, null where nothing is known."""
    stages = {stage.name: _ms(frame.seconds(stage)) for stage in (*STAGES, TOTAL)}
    return json.dumps({"capture_time_ns": frame.capture_ns, "ms": stages, "instants_ns": dict(frame.instants)})


def frame_as_line(frame: Frame) -> str:
    """One plain line for each frame."""
    known = [(stage.name, frame.seconds(stage)) for stage in (*STAGES, TOTAL)]
    times = "  ".join(f"{name} {took * 1e3:.2f}" for name, took in known if took is not None)
    return f"{frame.capture_ns / 1e9:.3f}  {times}  ms"


def summary_as_line(statistics: Statistics) -> str:
    """One plain line that ends a trace."""
    parts = [
        f"{summary.stage.name} {_text(summary.p50_s)} (p99 {_text(summary.p99_s)})"
        for summary in statistics.summaries()
        if summary.frames
    ]
    return f"{statistics.frames} frames, p50 in ms: {', '.join(parts)}{_warning(statistics)}"


def summary_as_dict(statistics: Statistics) -> dict[str, Any]:
    """The same for programs."""
    return {
        "frames": statistics.frames,
        "contradicted": statistics.contradicted,
        "stages": {
            summary.stage.name: {
                "frames": summary.frames,
                "last_ms": _ms(summary.last_s),
                "p50_ms": _ms(summary.p50_s),
                "p99_ms": _ms(summary.p99_s),
            }
            for summary in statistics.summaries()
        },
    }


def picture(statistics: Statistics) -> "RenderableType":
    """A table with bars from frames sent on: each stage begins where the one before it ends, in the middle of many."""
    from rich.console import Group
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    table.add_column("stage", no_wrap=True)
    for name in ("p50", "p99", "last"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("", min_width=_BAR, no_wrap=True)
    table.add_column("", no_wrap=True, overflow="ellipsis")
    summaries = statistics.summaries()
    whole = sum(summary.p50_s or 0.0 for summary in summaries if _on_the_way(summary)) or 1.0
    at = 0.0
    for summary in summaries:
        begin = at if _on_the_way(summary) else 0.0
        end = begin + (summary.p50_s or 0.0)
        shown = summary.frames and (_on_the_way(summary) or summary.stage is TOTAL)
        table.add_row(
            f"{summary.stage.name}{' *' if summary.stage.heard else ''}",
            *(_text(value) for value in (summary.p50_s, summary.p99_s, summary.last_s)),
            bar(begin / whole, end / whole) if shown else "",
            summary.stage.what,
            style="bold" if summary.stage is TOTAL else None,
        )
        at = end if _on_the_way(summary) else at
    return Group(table, _caption(statistics))


def bar(begin: float, end: float, width: int = _BAR) -> str:
    """A bar from one share of the width to another; at least one mark."""
    first = min(width - 1, max(0, round(begin * width)))
    last = min(width, max(first + 1, round(end * width)))
    return " " * first + "█" * (last - first)


def _on_the_way(summary: Summary) -> bool:
    """Whether a stage comes after frames were sent: drawing is no part of what the loop takes."""
    return summary.stage is not TOTAL and summary.stage.end != TOTAL.begin


def _caption(statistics: Statistics) -> str:
    note = "ms; * one end by the clock of this command, when it heard of it"
    return f"{statistics.frames} frames; {note}{_warning(statistics)}"


def _warning(statistics: Statistics) -> str:
    if not statistics.contradicted:
        return ""
    return f"; {statistics.contradicted} stages left out that end before they begin: set the machines' clocks alike"


def _ms(seconds: float | None) -> float | None:
    return None if seconds is None else round(seconds * 1e3, 4)


def _text(seconds: float | None) -> str:
    return "-" if seconds is None else f"{seconds * 1e3:.2f}"
