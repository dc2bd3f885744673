"""Inverse kinematics: pure functions from a problem to a solution, by name; usable without the bus.

Where the reach of an arm is known in closed form, a target beyond it is moved to the nearest point that is reached
before any solver sees it, and the solution says so: near and beyond the edge of the workspace all solvers then behave
alike. For other chains the batched solvers go as near as they can and say that.
"""

from armsight_control.solvers.dispatch import SOLVERS, beside_the_loop, check_applies, check_solver, solve, solve_batch
from armsight_control.solvers.options import (
    ClosedFormOptions,
    GradientDescentOptions,
    LevenbergMarquardtOptions,
    Options,
    TorchOptions,
)
from armsight_control.solvers.problem import REPORT_FREE, Problem, Solution, Solutions, Status

__all__ = [
    "REPORT_FREE",
    "SOLVERS",
    "ClosedFormOptions",
    "GradientDescentOptions",
    "LevenbergMarquardtOptions",
    "Options",
    "Problem",
    "Solution",
    "Solutions",
    "Status",
    "TorchOptions",
    "beside_the_loop",
    "check_applies",
    "check_solver",
    "solve",
    "solve_batch",
]
