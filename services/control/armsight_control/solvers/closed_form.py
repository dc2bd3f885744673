r"""Exact inverse kinematics of the report's arm with joint 2 at 0: all branches first, then the nearest one.

With h the height of the target over the shoulder and rho its distance from the z-axis, :math:`r_3 \cdot r_4 = \cos\psi`
fixes psi up to its sign, :math:`h = c_\phi (L_3 + L_4 c_\psi)` phi up to its sign, and theta is what turns the tip to
the target's azimuth: four solutions, which lie within the limits for every reachable target.
"""

import math

import numpy as np

from armsight_control.chain import Array
from armsight_control.kinematics import Links
from armsight_control.solvers.workspace import TOLERANCE_M, cos_psi


def branches(links: Links, target: Array, theta_on_axis: float) -> Array:
    """All solutions (4, 3) of theta, phi, psi for a reachable target.

    Args:
        links: the lengths.
        target: base frame, metres; see :func:`~armsight_control.solvers.workspace.nearest_reachable`.
        theta_on_axis: theta for a target on the z-axis, where any is right.
    """
    x, y, h = float(target[0]), float(target[1]), float(target[2]) - links.l1
    rho = math.hypot(x, y)
    c = min(1.0, max(0.0, cos_psi(links, rho, h)))
    across = links.l4 * math.sqrt(1 - c * c)
    level = math.sqrt(max(0.0, rho * rho - across * across))
    psi, phi = math.atan2(across, links.l4 * c), math.atan2(level, max(0.0, h))
    azimuth = math.atan2(y, x) if rho > TOLERANCE_M else theta_on_axis
    found = np.empty((4, 3))
    for i, (psi_sign, phi_sign) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1))):
        # before theta turns it, the tip lies at (across, -level) with these signs
        theta = azimuth - math.atan2(-phi_sign * level, psi_sign * across) if rho > TOLERANCE_M else azimuth
        found[i] = math.remainder(theta, 2 * math.pi), phi_sign * phi, psi_sign * psi
    return found


def nearest(links: Links, target: Array, start: Array) -> Array:
    """The solution (theta, phi, psi) nearest to a configuration of the same three joints."""
    found = branches(links, target, float(start[0]))
    return np.asarray(found[int(np.argmin(((found - start) ** 2).sum(axis=1)))])
