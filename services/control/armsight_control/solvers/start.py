"""Where a descent starts: the report's three initialisations."""

from functools import lru_cache
from typing import Literal

import numpy as np

from armsight_control.chain import Array, Chain
from armsight_control.folded import Folded
from armsight_control.kinematics import links_of_report
from armsight_control.solvers.problem import REPORT_FREE

Initialisation = Literal["fixed", "previous", "random"]
INITIALISATIONS: tuple[Initialisation, ...] = ("fixed", "previous", "random")

SIGMA_RAD = 0.005
"""Of the report's q0 ~ N(0, 0.005), read as the standard deviation."""

FIXED_RAD = 0.5
"""Of `fixed`, every free joint: away from the straight poses, where the error has saddles."""

FIXED_JOINT = 1
"""The report's inverse kinematics keeps joint 2 of its arm at 0; other arms hold none."""


def start(chain: Chain, initialisation: Initialisation, previous: Array | None, rng: np.random.Generator) -> Array:
    """The configuration to start from, inside the limits; of the report's arm with joint 2 at 0.

    Args:
        chain: the arm.
        initialisation: which of the three.
        previous: the last solution, for `previous`; without one it starts as `random` does.
        rng: source of `random`.
    """
    if initialisation == "fixed":
        return for_free(chain, np.full(chain.count, FIXED_RAD), REPORT_FREE)
    if initialisation == "previous" and previous is not None:
        return for_free(chain, previous, REPORT_FREE)
    return perturbed(chain, np.zeros(chain.count), REPORT_FREE, rng)


def perturbed(chain: Chain, q: Array, free: tuple[int, ...], rng: np.random.Generator) -> Array:
    """A configuration with the report's noise on top; else as :func:`for_free`."""
    return for_free(chain, q + rng.normal(0.0, SIGMA_RAD, chain.count), free)


def for_free(chain: Chain, q: Array, free: tuple[int, ...]) -> Array:
    """The configuration inside the limits; of the report's arm with joint 2 at 0 unless it is free."""
    moved = chain.clip(q)
    if FIXED_JOINT not in free and links_of_report(chain) is not None:
        moved[FIXED_JOINT] = 0.0
    return moved


@lru_cache(maxsize=64)
def spread(folded: Folded, count: int, seed: int) -> Array:
    """Starts (count, n) all over the limits, in u = q + offset: the same ones for every target."""
    limits = folded.limits
    drawn = np.random.default_rng(seed).uniform(limits[:, 0], limits[:, 1], (count, len(limits)))
    drawn.setflags(write=False)
    return drawn
