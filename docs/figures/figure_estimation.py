"""Of docs/explanation/estimation.md: the estimator at work, with markers that get lost."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import paper
from armsight.times import NS_PER_S
from armsight_control import AllJoints, Positions, SeenMarker
from armsight_control.chain import Array
from armsight_control.kinematics import position
from armsight_control.trajectory import all_motion

FPS, SECONDS = 30, 12
NOISE_M = 0.002
HIDDEN_S = (5.0, 6.0)
"""Red and blue are seen by nobody: yellow alone is left."""


@dataclass(frozen=True, slots=True)
class Followed:
    """The test motion of all joints, as the estimator sees it."""

    seconds: Array
    errors: Array
    sigmas: Array

    @property
    def hidden(self) -> NDArray[np.bool_]:
        """Which instants lack red and blue."""
        return np.asarray((self.seconds >= HIDDEN_S[0]) & (self.seconds < HIDDEN_S[1]))


@cache
def followed() -> Followed:
    """Markers where the pose puts them, with noise; the setpoint is where the arm is to be."""
    arm, rng = paper.arm(), np.random.default_rng(0)
    estimator, track = AllJoints(arm), None
    seconds = np.arange(FPS * SECONDS) / FPS
    errors, sigmas = [], []
    for now in seconds:
        truth = all_motion(float(now))
        names = [name for name in arm.markers if not (HIDDEN_S[0] <= now < HIDDEN_S[1] and name in ("red", "blue"))]
        seen = {
            name: SeenMarker(
                position(arm.chain, truth, arm.markers[name]) + rng.normal(0.0, NOISE_M, 3),
                np.eye(3) * NOISE_M**2,
                one_view=False,
            )
            for name in names
        }
        outcome = estimator.step(track, Positions(round(now * NS_PER_S), seen), truth)
        track = outcome.track
        errors.append(outcome.estimate.angles - truth)
        sigmas.append(outcome.sigma)
    return Followed(seconds, np.array(errors), np.array(sigmas))


def facts() -> list[str]:
    """What the page says in numbers."""
    run = followed()
    settled = ~run.hidden & (run.seconds > 1.0)
    rms = 1000 * np.sqrt((run.errors[settled] ** 2).mean(axis=0))
    after = (run.seconds >= HIDDEN_S[1] + 0.5) & (run.seconds < HIDDEN_S[1] + 1.0)
    assert (1000 * np.abs(run.errors[after]) < 10).all()
    last = np.flatnonzero(run.hidden)[-1]
    return [
        f"{1000 * NOISE_M:.0f} mm of noise",
        f"{rms.min():.1f} to {rms.max():.1f} mrad",
        f"for {HIDDEN_S[1] - HIDDEN_S[0]:.0f} s",
        f"to {1000 * run.sigmas[last].max():.0f} mrad",
        f"by {1000 * np.abs(run.errors[run.hidden]).max():.0f} mrad",
    ]


def estimate() -> Figure:
    """Errors of joints 1 and 4 within two standard deviations."""
    run = followed()
    drawn = paper.figure(7.0, 4.2)
    for axes, joint, name in zip(drawn.subplots(4, 1, sharex=True), range(4), "ϑνϕψ", strict=True):
        band = 2000 * run.sigmas[:, joint]
        axes.fill_between(run.seconds, -band, band, color=paper.BAND, linewidth=0)
        axes.plot(run.seconds, 1000 * run.errors[:, joint], color=paper.LINK, linewidth=0.8)
        axes.axvspan(*HIDDEN_S, color=paper.TRUE, alpha=0.25, linewidth=0)
        axes.set(ylabel=f"{name}, mrad", ylim=(-25, 25))
    axes.set(xlabel="time, s")
    return drawn


FIGURES = {"estimate": estimate}
