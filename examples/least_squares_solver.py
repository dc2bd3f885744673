"""A solver for inverse kinematics of one's own: SciPy's least squares, from the start and then from anywhere.

armsight-control --solver examples/least_squares_solver.py:solve
"""

import numpy as np
from scipy.optimize import least_squares

from armsight_control import Chain, forward, jacobian

GOOD_M, TRIES = 1e-4, 20


def solve(chain: Chain, target: np.ndarray, start: np.ndarray, free: tuple[int, ...]) -> np.ndarray:
    """The angles of all joints (n,) that put the tip nearest to the target (3,); only those in `free` move."""
    moving, rng, ends = list(free), np.random.default_rng(0), []
    lower, upper = chain.limits[moving].T

    def whole(x: np.ndarray) -> np.ndarray:
        q = start.copy()
        q[moving] = x
        return q

    for attempt in range(TRIES):
        begin = start[moving] if attempt == 0 else rng.uniform(lower, upper)
        end = least_squares(
            lambda x: forward(chain, whole(x)) - target,
            np.clip(begin, lower + 1e-6, upper - 1e-6),
            jac=lambda x: jacobian(chain, whole(x))[:, moving],
            bounds=(lower, upper),
        )
        ends.append(end)
        if np.sqrt(2 * end.cost) < GOOD_M:
            break
    return whole(min(ends, key=lambda end: float(end.cost)).x)
