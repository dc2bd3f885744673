"""Of docs/explanation/geometry.md: a pose and its twin."""

import math

import numpy as np
from matplotlib.figure import Figure

import paper
from armsight_control import Links, Point, links_of
from armsight_control.chain import Array
from armsight_control.kinematics import forward, frames, position

POSE = np.array([0.6, 0.4, 0.9, -0.7])
TWIN = np.array([POSE[0] - math.pi, *-POSE[1:]])


def facts() -> list[str]:
    """What the page says in numbers."""
    arm, links = paper.arm(), links_of(paper.arm().chain)
    rng = np.random.default_rng(1)
    poses = rng.uniform(arm.chain.limits[:, 0], arm.chain.limits[:, 1], (1000, 4))
    twins = np.column_stack([poses[:, 0] - np.copysign(math.pi, poses[:, 0]), -poses[:, 1:]])
    apart = max(np.abs(position(arm.chain, poses, at) - position(arm.chain, twins, at)).max() for at in _points())
    assert apart < 1e-14
    nearest, farthest = (_from_shoulder(links, psi) for psi in (math.pi / 2, 0.0))
    offsets = {name: _offset(name) for name in arm.markers}
    return [
        f"$L_1$ = {links.l1:.1f} m, $L_3$ = {links.l3:.1f} m, $L_4$ = {links.l4:.1f} m",
        f"{forward(arm.chain, np.zeros(4))[2]:.0f} m above joint 1",
        f"from {nearest:.2f} m",
        f"to {farthest:.1f} m",
        f"green {offsets['green']:.2f} m, yellow {offsets['yellow']:.2f} m, blue {offsets['blue']:.2f} m",
        f"red {arm.markers['red'].position[2] - arm.chain.tip.position[2]:.2f} m beyond the tip",
        f"{len(poses):,} random poses",
        f"({', '.join(f'{angle:.1f}' for angle in POSE)})",
        f"({', '.join(f'{angle:.2f}' for angle in TWIN)})",
    ]


def _points() -> list[Point]:
    return [*paper.arm().markers.values(), paper.arm().chain.tip]


def _offset(marker: str) -> float:
    return float(np.linalg.norm(paper.arm().markers[marker].position))


def _from_shoulder(links: Links, psi: float) -> float:
    return float(np.linalg.norm(forward(paper.arm().chain, np.array([0.3, 0.0, 0.8, psi])) - [0.0, 0.0, links.l1]))


def twin() -> Figure:
    """One pose and its twin from two sides, links beside each other as they coincide."""
    drawn = paper.figure(4.6, 4.0)
    left, right = drawn.subplots(1, 2)
    for axes, (across, up), labels in ((left, (0, 2), "xz"), (right, (1, 2), "yz")):
        for q, colour, width, name in ((POSE, paper.LINK, 5.0, "pose"), (TWIN, paper.TWIN, 1.6, "its twin")):
            joints = _joints(q)
            axes.plot(joints[:, across], joints[:, up], color=colour, linewidth=width, label=name, zorder=1)
        for marker, point in paper.arm().markers.items():
            centre = position(paper.arm().chain, POSE, point)
            axes.plot(centre[across], centre[up], "o", color=paper.MARKERS[marker], markersize=9, zorder=3)
        axes.set(xlabel=f"{labels[0]}, m", ylabel=f"{labels[1]}, m", aspect="equal")
    right.legend(loc="lower left")
    return drawn


def _joints(q: Array) -> Array:
    """Joints 1, 2, 4 and the tip, base frame."""
    chain = paper.arm().chain
    _, origins = frames(chain, q)
    return np.vstack([origins[1], origins[2], origins[4], forward(chain, q)])


FIGURES = {"twin": twin}
