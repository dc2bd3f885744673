"""Solves for one target, and says what the arm can't reach: `python services/control/examples/solve_a_pose.py`.

The arm is written down here; from a running simulation it comes as `arm_of(description).chain`.
"""

import math

import numpy as np

from armsight_control import REPORT_FREE, Chain, Point, Problem, forward, solve

QUARTER = math.pi / 2
ARM = Chain(
    names=("joint1", "joint2", "joint3", "joint4"),
    origins=np.array([[0, 0, 0], [0, 0, 4.0], [0, 0, 0], [0, 0, 3.2]]),
    axes=np.array([[0.0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 1, 0]]),
    limits=np.array([[-math.pi, math.pi], [-QUARTER, QUARTER], [-QUARTER, QUARTER], [-QUARTER, QUARTER]]),
    max_speed=np.full(4, 5.0),
    tip=Point(3, np.array([0, 0, 2.8])),
)


def main() -> None:
    """One target within reach, and one that needs joint 2."""
    start = np.array([0.3, 0.0, -0.5, 0.5])
    for target in (np.array([3.6, 1.2, 7.5]), np.array([4.5, 0.0, 3.0])):
        for free in (REPORT_FREE, (0, 1, 2, 3)):
            solution = solve("closed-form", Problem(ARM, target, start, free))
            at = ", ".join(f"{angle:+.3f}" for angle in solution.q)
            said = f"{solution.status.value}, {solution.residual_m:.3f} m off, at {at}"
            print(f"{target} with {len(free)} joints: {said}")
            assert np.allclose(forward(ARM, solution.q), solution.tip)


if __name__ == "__main__":
    main()
