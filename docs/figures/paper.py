"""What all figures have in common: the arm that they are about, how they look, and how they are written."""

from functools import cache
from pathlib import Path
from typing import Any

import matplotlib as mpl
from google.protobuf import json_format
from matplotlib.figure import Figure

from armsight.v1.description_pb2 import ArmDescription
from armsight_control import Arm, arm_of

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images" / "figures"

LINK, TWIN, TRUE, OURS, OTHERS, BAND = "#333333", "#d95f02", "#999999", "#1f78b4", "#d95f02", "#a6cee3"
MARKERS = {"green": "#33a02c", "yellow": "#e6b800", "blue": "#1f78b4", "red": "#e31a1c"}

_STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    # the same bytes from every run: text as text, names of parts from a fixed seed, every point kept
    "svg.fonttype": "none",
    "svg.hashsalt": "armsight",
    "path.simplify": False,
}


@cache
def arm() -> Arm:
    """As the simulation describes it."""
    text = (ROOT / "services/control/examples/arm.json").read_text(encoding="utf-8")
    return arm_of(json_format.Parse(text, ArmDescription()))


def figure(width: float, height: float) -> Figure:
    """An empty figure, inches."""
    mpl.rcParams.update(_STYLE)
    return Figure(figsize=(width, height), layout="constrained")


def save(drawn: Figure, file: Path) -> None:
    """As SVG, without the time at which it was drawn."""
    mpl.rcParams.update(_STYLE)
    file.parent.mkdir(parents=True, exist_ok=True)
    drawn.savefig(file, format="svg", metadata={"Date": None})
