"""Of docs/explanation/kinematics.md: where the report's descent ends, and what the arm reaches."""

from functools import cache

import numpy as np
from matplotlib.figure import Figure

import paper
from armsight_control import REPORT_FREE, Links, Problem, links_of, report_forward, report_jacobian, solve
from armsight_control.chain import Array
from armsight_control.solvers import GradientDescentOptions
from armsight_control.solvers.start import SIGMA_RAD
from armsight_control.solvers.workspace import nearest_reachable, reaches

TARGETS, LONG_STEPS = 1000, 5000
SHOWN = 8
# Below, rounding is drawn.
_LEAST_M = 1e-5
BEYOND = ((6.5, 1.5), (1.0, 3.0), (4.5, -1.0), (0.5, 5.0))
"""Out of reach with joint 2 at 0: distance from the z-axis, height over the shoulder."""


@cache
def descended() -> Array:
    """The report's descent on all targets at once: mean absolute error by step, (steps + 1, targets), metres."""
    links, limits = _links(), paper.arm().chain.limits[list(REPORT_FREE)]
    rng, options = np.random.default_rng(0), GradientDescentOptions()
    goals = rng.uniform(limits[:, 0], limits[:, 1], (TARGETS, 3))
    targets = report_forward(links, goals)
    q = rng.normal(0.0, SIGMA_RAD, (TARGETS, 3))
    errors = np.empty((LONG_STEPS + 1, TARGETS))
    for step in range(LONG_STEPS + 1):
        off = targets - report_forward(links, q)
        errors[step] = np.abs(off).mean(axis=1)
        gradient = -2 / 3 * np.einsum("mij,mi->mj", report_jacobian(links, q), off)
        q = np.clip(q - options.alpha * gradient, limits[:, 0], limits[:, 1])
    return errors


def facts() -> list[str]:
    """What the page says in numbers."""
    options, errors = GradientDescentOptions(), descended()
    met = np.minimum.accumulate(errors, axis=0) < options.tolerance_m
    slope = report_jacobian(_links(), np.zeros(3))
    assert not slope[:, 0].any()
    start = np.array([0.3, 0.0, -0.5, 0.5])
    far = solve("closed-form", Problem(paper.arm().chain, np.array([4.5, 0.0, 3.0]), start, REPORT_FREE))
    near = solve("closed-form", Problem(paper.arm().chain, np.array([4.5, 0.0, 3.0]), start, (0, 1, 2, 3)))
    assert near.residual_m < 1e-9
    return [
        f"α = {options.alpha}",
        f"{1000 * options.tolerance_m:.0f} mm",
        f"{options.max_steps} steps",
        f"{TARGETS:,} random targets",
        f"{100 * met[options.max_steps].mean():.0f} %",
        f"with {LONG_STEPS:,} steps {100 * met[LONG_STEPS].mean():.0f} %",
        f"(4.5, 0, 3) it misses by {far.residual_m:.2f} m",
    ]


def _links() -> Links:
    return links_of(paper.arm().chain)


def descent() -> Figure:
    """The error of some targets, step by step, and the share that has met the tolerance."""
    options, errors = GradientDescentOptions(), descended()
    drawn = paper.figure(7.0, 3.0)
    left, right = drawn.subplots(1, 2)
    steps = np.unique(np.geomspace(1, LONG_STEPS, 120).astype(int))
    left.plot(steps, np.maximum(errors[steps][:, :SHOWN], _LEAST_M), color=paper.OURS, linewidth=0.9)
    left.axhline(options.tolerance_m, color=paper.OTHERS, linestyle="--")
    left.set(xscale="log", yscale="log", xlabel="step", ylabel="mean absolute error, m")
    met = 100 * (np.minimum.accumulate(errors, axis=0) < options.tolerance_m).mean(axis=1)
    right.plot(steps, met[steps], color=paper.OURS)
    right.axvline(options.max_steps, color=paper.OTHERS, linestyle="--")
    right.set(xscale="log", xlabel="step", ylabel="targets within the tolerance, %", ylim=(0, 100))
    return drawn


def reach() -> Figure:
    """The half-plane through the z-axis: what is reached, and the nearest point for what is not."""
    links = _links()
    rho, h = np.meshgrid(np.linspace(0.0, 7.5, 151), np.linspace(-4.0, 6.5, 211))
    drawn = paper.figure(4.2, 4.6)
    axes = drawn.subplots()
    for moving, colour, name in (("all four", paper.BAND, "all joints"), ("joint 2 at 0", paper.OURS, "joint 2 at 0")):
        inside = np.asarray(reaches(links, rho, h, moving), dtype=np.float64)  # type: ignore[arg-type]
        axes.contourf(rho, h, inside, levels=[0.5, 1.5], colors=[colour])
        axes.plot([], [], "s", color=colour, label=name)
    for aside, up in BEYOND:
        near, _ = nearest_reachable(links, np.array([aside, 0.0, up + links.l1]), 0.0)
        axes.plot([aside, near[0]], [up, near[2] - links.l1], color=paper.LINK)
        axes.plot(aside, up, "o", color=paper.OTHERS, markersize=4)
    axes.set(xlabel="distance from the z-axis, m", ylabel="height over the shoulder, m", aspect="equal")
    axes.legend(loc="lower right")
    return drawn


FIGURES = {"descent": descent, "reach": reach}
