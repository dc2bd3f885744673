"""An estimator of one's own: five steps of Gauss-Newton on the markers of this instant, from the setpoint in force.

armsight-control --estimator examples/gauss_newton_estimator.py:FromSetpoint
"""

import numpy as np

from armsight_control import Arm, Positions
from armsight_control.estimators.marker_model import MarkerModel

STEPS = 5
LEAST_RAD = 1e-2  # of the setpoint's weight: what no marker tells stays near it


class FromSetpoint:
    """Has no memory: the setpoint settles which of the poses that look alike it is."""

    def __init__(self, arm: Arm) -> None:
        """Asked once for each arm."""
        self.model = MarkerModel(arm)

    def step(self, positions: Positions, setpoint: np.ndarray) -> np.ndarray:
        """The angles of all joints, (n,) radians."""
        seen = {name: marker for name, marker in positions.seen.items() if name in self.model.index}
        rows, q = [self.model.index[name] for name in seen], setpoint
        if not seen:
            return setpoint
        for _ in range(STEPS):
            placed = self.model.at(q)
            off = np.concatenate([marker.position for marker in seen.values()]) - placed.points[rows].ravel()
            slopes = placed.jacobians[rows].reshape(-1, len(q))
            q = q + np.linalg.solve(slopes.T @ slopes + LEAST_RAD**2 * np.eye(len(q)), slopes.T @ off)
        return q
