"""All solvers on the same random targets: `python services/control/examples/compare_solvers.py [TARGETS]`.

How they compare on more targets, with other libraries beside them, is measured by `services/control/bench/ik_bench.py`.
"""

import sys
from time import perf_counter

import numpy as np
from solve_a_pose import ARM

from armsight_control import REPORT_FREE, SOLVERS, forward, solve_batch


def main(count: int) -> None:
    """Prints for each solver how many targets it reaches, how nearly, and in what time."""
    rng = np.random.default_rng(1)
    goals, starts = (rng.uniform(ARM.limits[:, 0], ARM.limits[:, 1], (count, 4)) for _ in range(2))
    goals[:, 1] = starts[:, 1] = 0.0
    targets = forward(ARM, goals)
    for name in SOLVERS:
        solve_batch(name, ARM, targets[:1], starts[:1], REPORT_FREE)  # the first call loads
        began = perf_counter()
        solutions = solve_batch(name, ARM, targets, starts, REPORT_FREE)
        seconds = perf_counter() - began
        reached = int((solutions.residual_m < 0.005).sum())
        print(
            f"{name:20} {reached:4} of {count} within 5 mm, median {np.median(solutions.residual_m):.1e} m, "
            f"{1e3 * seconds / count:.3f} ms a target {solutions.note}"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
