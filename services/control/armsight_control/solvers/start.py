"""Where a descent starts: the report's three initialisations."""

from functools import lru_cache
from typing import Literal

import numpy as np

from armsight_control.chain import Array, Chain
from armsight_control.folded import Folded
from armsight_control.solvers.problem import REPORT_FREE

Initialisation = Literal["fixed", "previous", "random"]
INITIALISATIONS: tuple[Initialisation, ...] = ("fixed", "previous", "random")

SIGMA_RAD = 0.005
"""Of the report's q0 ~ N(0, 0.005), read as the standard deviation."""

FIXED_RAD = 0.5
"""Of `fixed`, every free joint: away from the straight poses, where the error has saddles."""

FIXED_JOINT = 1
"""The report's inverse kinematics keeps joint 2 at 0."""


def start(chain: Chain, initialisation: Initialisation, previous: Array | None, rng: np.random.Generator) -> Array:
    """The configuration to start from, joint 2 at 0, inside the limits.

    Args:
        chain: the arm.
        initialisation: which of the three.
        previous: the last solution, for `previous`; without one it starts as `random` does.
        rng: source of `random`.
    """
    if initialisation == "fixed":
        return with_joint2_at_0(chain, np.full(chain.count, FIXED_RAD))
    if initialisation == "previous" and previous is not None:
        return with_joint2_at_0(chain, previous)
    return perturbed(chain, np.zeros(chain.count), REPORT_FREE, rng)


def perturbed(chain: Chain, q: Array, free: tuple[int, ...], rng: np.random.Generator) -> Array:
    """A configuration with the report's noise on top, joint 2 at 0 unless it is free."""
    return for_free(chain, q + rng.normal(0.0, SIGMA_RAD, chain.count), free)


def for_free(chain: Chain, q: Array, free: tuple[int, ...]) -> Array:
    """The configuration inside the limits and with joint 2 at 0 unless it is free."""
    return chain.clip(q) if FIXED_JOINT in free else with_joint2_at_0(chain, q)


def with_joint2_at_0(chain: Chain, q: Array) -> Array:
    """The configuration inside the limits and with joint 2 at 0."""
    moved = chain.clip(q)
    moved[FIXED_JOINT] = 0.0
    return moved


@lru_cache(maxsize=64)
def spread(folded: Folded, count: int, seed: int) -> Array:
    """Starts (count, n) all over the limits, in u = q + offset: the same ones for every target."""
    limits = folded.limits
    drawn = np.random.default_rng(seed).uniform(limits[:, 0], limits[:, 1], (count, len(limits)))
    drawn.setflags(write=False)
    return drawn
