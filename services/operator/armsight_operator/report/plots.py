"""Plots of estimated and true angles, and of their errors."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from armsight_operator.report.chain import Array
from armsight_operator.report.measure import Part, PoseRow

# Colours that readers with the usual colour-blindnesses can tell apart (Okabe and Ito).
_TRUE, _ESTIMATED, _OTHER = "#555555", "#0072B2", "#D55E00"
_LETTERS = {"theta": "θ", "nu": "ν", "phi": "ϕ", "psi": "ψ"}
_DPI = 110


def plot_table1(rows: list[PoseRow], file: Path) -> None:
    """Error of every pose, ours and the report's, on one logarithmic axis."""
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    axes = figure.subplots()
    at = np.arange(1, len(rows) + 1)
    width = 0.27
    series = (
        ("the report", [row.report_measured for row in rows], _TRUE),
        ("its method on our frames", [row.report_method for row in rows], _OTHER),
        ("armsight", [row.measured for row in rows], _ESTIMATED),
    )
    for index, (label, points, color) in enumerate(series):
        error = [1000 * float(np.linalg.norm(p - row.truth)) for p, row in zip(points, rows, strict=True)]
        axes.bar(at + (index - 1) * width, error, width, label=label, color=color)
    axes.set_yscale("log")
    axes.set_xticks(at)
    axes.set_xlabel("pose")
    axes.set_ylabel("end effector error, mm")
    axes.grid(axis="y", alpha=0.3)
    axes.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, 1.18), frameon=False)
    figure.savefig(file, dpi=_DPI)


def plot_part(part: Part, folder: Path, key: str) -> None:
    """Angles and errors of a motion, in files that are named by a key."""
    plot_angles(part, folder / f"{key}_angles.png")
    plot_errors(part, folder / f"{key}_errors.png")


def plot_angles(part: Part, file: Path) -> None:
    """Estimated and true angle over time, a panel a joint."""
    figure = Figure(figsize=(8, 5.5), layout="constrained")
    for index, (axes, symbol) in enumerate(_panels(figure, part)):
        axes.plot(part.time_s, part.true[:, index], color=_TRUE, linewidth=3, alpha=0.5, label="true")
        axes.plot(part.time_s, part.estimated[:, index], color=_ESTIMATED, linewidth=1, label="estimated")
        axes.set_ylabel(f"{symbol}, rad")
    figure.axes[0].legend(ncols=2, loc="upper right", frameon=False)
    figure.savefig(file, dpi=_DPI)


def plot_errors(part: Part, file: Path) -> None:
    """Error over time, a panel a joint; shaded where the joint can't be observed."""
    figure = Figure(figsize=(8, 5.5), layout="constrained")
    for index, (axes, symbol) in enumerate(_panels(figure, part)):
        axes.plot(part.time_s, 1000 * part.error[:, index], color=_OTHER, linewidth=1)
        hidden = ~part.observable[:, index]
        if hidden.any():
            low, high = axes.get_ylim()
            axes.fill_between(part.time_s, low, high, where=hidden, color=_TRUE, alpha=0.2, label="not observable")
            axes.legend(loc="upper right", frameon=False)
        axes.set_ylabel(f"{symbol}, mrad")
    figure.savefig(file, dpi=_DPI)


def plot_tip(time_s: Array, distance_m: Array, file: Path) -> None:
    """How far the tip is from its target over time."""
    figure = Figure(figsize=(8, 2.6), layout="constrained")
    axes = figure.subplots()
    axes.plot(time_s, 1000 * distance_m, color=_OTHER, linewidth=1)
    axes.set_xlabel("time, s")
    axes.set_ylabel("tip from target, mm")
    axes.grid(alpha=0.3)
    figure.savefig(file, dpi=_DPI)


def _panels(figure: Figure, part: Part):  # type: ignore[no-untyped-def]
    panels = figure.subplots(len(part.symbols), 1, sharex=True)
    for axes in panels:
        axes.grid(alpha=0.3)
    panels[-1].set_xlabel("time of the test, s")
    return list(zip(panels, (_LETTERS.get(symbol, symbol) for symbol in part.symbols), strict=True))
