"""Of docs/explanation/motion.md: a setpoint on its way, bounded in speed, acceleration and jerk."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from matplotlib.figure import Figure

import paper
from armsight_control.chain import Array
from armsight_control.trajectory import ARRIVED_RAD, MotionLimits, Planner, at_rest, resting

FPS = 30
FROM, TO = np.zeros(4), np.array([1.2, 0.0, 0.8, -0.4])


@dataclass(frozen=True, slots=True)
class Way:
    """A motion from rest to rest, a row for each frame."""

    seconds: Array
    position: Array
    velocity: Array
    acceleration: Array


@cache
def way() -> Way:
    """Step by step, as control answers frames."""
    planner, state, states = Planner(paper.arm().chain, MotionLimits()), at_rest(FROM), [at_rest(FROM)]
    while np.abs(state.position - TO).max() > ARRIVED_RAD:
        state = planner.towards(state, resting(TO), 1 / FPS).state
        states.append(state)
        assert len(states) < 1000
    return Way(
        np.arange(len(states)) / FPS,
        np.array([each.position for each in states]),
        np.array([each.velocity for each in states]),
        np.array([each.acceleration for each in states]),
    )


def facts() -> list[str]:
    """What the page says in numbers."""
    limits, chain, done = MotionLimits(), paper.arm().chain, way()
    fastest = np.abs(done.velocity).max(axis=0)
    assert (fastest <= limits.speed(chain) + 1e-9).all()
    assert np.abs(done.acceleration).max() <= limits.acceleration_rad_s2 + 1e-9
    return [
        f"{100 * limits.speed_share:.0f} % of each joint's {chain.max_speed[0]:.0f} rad/s",
        f"{limits.acceleration_rad_s2:.0f} rad/s²",
        f"{limits.jerk_rad_s3:.0f} rad/s³",
        f"{TO[0]:.1f} rad takes {done.seconds[-1]:.2f} s",
        f"{fastest[0]:.1f} rad/s",
    ]


def motion() -> Figure:
    """Position, velocity and acceleration of the joints that move."""
    done, limits = way(), MotionLimits()
    drawn = paper.figure(6.0, 4.2)
    rows = (
        ("rad", done.position, None),
        ("rad/s", done.velocity, limits.speed(paper.arm().chain)[0]),
        ("rad/s²", done.acceleration, limits.acceleration_rad_s2),
    )
    for axes, (unit, values, most) in zip(drawn.subplots(3, 1, sharex=True), rows, strict=True):
        for joint, colour in ((0, paper.OURS), (2, paper.OTHERS), (3, paper.MARKERS["green"])):
            axes.plot(done.seconds, values[:, joint], color=colour, label=f"joint {joint + 1}")
        if most is not None:
            for side in (-most, most):
                axes.axhline(side, color=paper.TRUE, linestyle="--", linewidth=0.8)
        axes.set(ylabel=unit)
    axes.set(xlabel="time, s")
    drawn.axes[0].legend(loc="upper left")
    return drawn


FIGURES = {"motion": motion}
