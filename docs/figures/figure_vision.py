"""Of docs/explanation/vision.md: what a fixed scale costs, what an outline tells, what one camera knows."""

import csv
import json
import math
from collections.abc import Iterator
from xml.etree import ElementTree

import numpy as np
from matplotlib.figure import Figure

import paper
from armsight_control.chain import Array
from armsight_operator.report.fixed_scale import metres_per_pixel

RIGHT_AT_M = 18.0
"""From each camera to the base's axis: where the fixed scale is right."""
HEIGHT_PX = 800
ASIDE_M = 3.0
"""Of the point in the figure from the camera's axis."""
# What no two cameras together leave open of blue.
_ONE_VIEW_M = 0.010
SPHERES = {"green": 0.7, "yellow": 0.6, "blue": 0.4, "red": 0.3}


def facts() -> list[str]:
    """What the page says in numbers."""
    focal, scale = _focal_px(), metres_per_pixel(RIGHT_AT_M, _focal_px())
    report = json.loads((paper.ROOT / "docs/report/summary.json").read_text(encoding="utf-8"))
    table, poses = report["table1"], report["random"]
    spreads = np.array([sigmas for _, sigmas in _spreads("blue")])
    by_two = spreads[spreads[:, 2] < _ONE_VIEW_M]
    beyond = _fixed_scale_error(RIGHT_AT_M + ASIDE_M)
    bias = max(_bias_px(radius, RIGHT_AT_M, 0.5) for radius in SPHERES.values())
    within = poses["markers"]["within_chi2_95"]
    return [
        f"f = {focal:.1f} px",
        f"{RIGHT_AT_M:.0f} m",
        f"{1000 * scale:.0f} mm",
        f"{ASIDE_M:.0f} m off the axis and {ASIDE_M:.0f} m too far away is put {beyond:.2f} m wrong",
        f"by {bias:.2f} px",
        f"mean squared error of {table['report_mse']} m²",
        f"gives {table['report_method_mse']:.3f} m²",
        f"ours {table['mse']:.1e} m²",
        f"{1000 * by_two.min():.1f} to {1000 * by_two.max():.1f} mm",
        f"up to {1000 * spreads[:, 2].max():.0f} mm",
        f"{poses['poses']:,} random poses",
        f"{100 * within['blue']:.1f} % of blue's, {100 * within['red']:.1f} % of red's",
        f"{100 * within['yellow']:.1f} % of yellow's",
        "95 %",
        f"to {_arc_error_mm(1 / 3):.1f} mm",
    ]


def _focal_px() -> float:
    """Of both cameras, from the simulation's model."""
    model = ElementTree.parse(paper.ROOT / "services/sim/armsight_sim/models/arm.xml")  # noqa: S314  our own file
    (fovy,) = {float(camera.attrib["fovy"]) for camera in model.iter("camera")}
    return HEIGHT_PX / 2 / math.tan(math.radians(fovy) / 2)


def _fixed_scale_error(distance_m: float) -> float:
    """By how much a point :data:`ASIDE_M` from the axis is put wrong by one scale for all distances."""
    pixels = _focal_px() * ASIDE_M / distance_m
    return abs(pixels * metres_per_pixel(RIGHT_AT_M, _focal_px()) - ASIDE_M)


def _bias_px(radius: float, distance: float, slope: float) -> float:
    """From a sphere's centre in the picture to the centre of its outline; slope: of the ray to the centre."""
    half = math.asin(radius / (distance * math.hypot(1.0, slope)))
    angle = math.atan(slope)
    ends = [_focal_px() * math.tan(angle + side * half) for side in (-1, 1)]
    return abs(sum(ends) / 2 - _focal_px() * slope)


def _arc_error_mm(share: float) -> float:
    """RMS error of blue across the view, from a share of its outline, each point of it known to a tenth of a pixel."""
    rng = np.random.default_rng(0)
    axis = np.array([0.2, 0.1, 1.0]) / math.sqrt(1.05)
    half = math.asin(SPHERES["blue"] / RIGHT_AT_M)
    across = np.linalg.svd(axis[None])[2][1:]
    off = []
    for _ in range(200):
        turns = rng.uniform(0, 2 * math.pi) + np.linspace(0.0, 2 * math.pi * share, 40)
        ring = np.cos(turns)[:, None] * across[0] + np.sin(turns)[:, None] * across[1]
        rays = math.cos(half) * axis + math.sin(half) * ring + rng.normal(0.0, 0.1 / _focal_px(), (40, 3))
        fitted = _cone(rays / np.linalg.norm(rays, axis=1, keepdims=True))
        off.append(RIGHT_AT_M * np.linalg.norm(np.cross(fitted, axis)))
    return float(1000 * np.sqrt(np.mean(np.square(off))))


def _cone(rays: Array) -> Array:
    """The axis of the cone of some rays: d · m = 1, linear in m."""
    m = np.linalg.lstsq(rays, np.ones(len(rays)), rcond=None)[0]
    return np.asarray(m / np.linalg.norm(m))


def _spreads(marker: str) -> Iterator[tuple[float, Array]]:
    """Time of each instant in seconds, and the standard deviations along the covariance's axes, as vision told them."""
    with (paper.ROOT / "services/control/examples/positions.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["marker"] == marker]
    for row in rows:
        xx, xy, xz, yy, yz, zz = (float(row[name]) for name in ("xx", "xy", "xz", "yy", "yz", "zz"))
        covariance = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        seconds = (int(row["capture_ns"]) - int(rows[0]["capture_ns"])) / 1e9
        yield seconds, np.sqrt(np.linalg.eigvalsh(covariance))


def fixed_scale() -> Figure:
    """What one pixel-to-metre constant makes of distance."""
    drawn = paper.figure(5.0, 2.8)
    axes = drawn.subplots()
    distances = np.linspace(12.0, 24.0, 61)
    axes.plot(distances, [_fixed_scale_error(distance) for distance in distances], color=paper.OTHERS)
    axes.set(xlabel="distance from the camera, m", ylabel="error of one fixed scale, m", ylim=(0, None))
    return drawn


def spread() -> Figure:
    """Blue's standard deviations while links hide it from one camera for a while."""
    drawn = paper.figure(6.0, 2.8)
    axes = drawn.subplots()
    told = list(_spreads("blue"))
    seconds, sigmas = np.array([at for at, _ in told]), 1000 * np.array([each for _, each in told])
    for i, name in enumerate(("best direction", "middle", "worst direction")):
        axes.plot(seconds, sigmas[:, i], color=(paper.TRUE, paper.OURS, paper.OTHERS)[i], label=name)
    axes.set(xlabel="time, s", ylabel="standard deviation of blue, mm", yscale="log")
    axes.legend()
    return drawn


FIGURES = {"fixed-scale": fixed_scale, "spread": spread}
