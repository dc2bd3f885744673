"""From joint positions to joint angles, inverse kinematics and joint commands; usable without the bus.

Examples:
    >>> import numpy as np
    >>> from armsight_control import Links, report_forward
    >>> report_forward(Links(l1=4.0, l3=3.2, l4=2.8), np.zeros(3)).tolist()
    [0.0, 0.0, 10.0]
"""

from armsight_control.chain import Chain, Point
from armsight_control.description import Arm, arm_of
from armsight_control.errors import ControlError
from armsight_control.estimators import ESTIMATORS, AllJoints, Estimate, Estimator, Outcome, Track
from armsight_control.kinematics import (
    Links,
    denavit_hartenberg,
    directions,
    forward,
    jacobian,
    links_of,
    report_forward,
    report_jacobian,
)
from armsight_control.positions import Positions, SeenMarker, positions_of
from armsight_control.solvers import (
    REPORT_FREE,
    SOLVERS,
    Options,
    Problem,
    Solution,
    Solutions,
    Status,
    solve,
    solve_batch,
)

__all__ = [
    "ESTIMATORS",
    "REPORT_FREE",
    "SOLVERS",
    "AllJoints",
    "Arm",
    "Chain",
    "ControlError",
    "Estimate",
    "Estimator",
    "Links",
    "Options",
    "Outcome",
    "Point",
    "Positions",
    "Problem",
    "SeenMarker",
    "Solution",
    "Solutions",
    "Status",
    "Track",
    "arm_of",
    "denavit_hartenberg",
    "directions",
    "forward",
    "jacobian",
    "links_of",
    "positions_of",
    "report_forward",
    "report_jacobian",
    "solve",
    "solve_batch",
]
