r"""The report's Part II: joint 2 fixed at 0, unknown theta, phi and psi.

.. math::
    r_3 &= (s_\vartheta s_\phi,\; -c_\vartheta s_\phi,\; c_\phi) \\
    r_4 &= (c_\vartheta s_\psi + s_\vartheta s_\phi c_\psi,\; s_\vartheta s_\psi - c_\vartheta s_\phi c_\psi,\;
            c_\phi c_\psi)

(theta, phi, psi) and (theta ± pi, -phi, -psi) give the same positions: continuity with the previous angles decides.
"""

import math

import numpy as np

from armsight_control.chain import Array
from armsight_control.estimators.estimate import Estimate, angle_between, clip1, judge

NAME = "part2"
FIXED_JOINT = 1

# Below this |sin(phi)| the right-hand formulas are used, and theta is held where |sin(psi)| is below it too.
THRESHOLD = 0.1

# Theta may touch ±pi and come back: the set is switched only beyond this margin. Without it noise at the seam switches
# sets back and forth (2.1 rad RMS over the report's motion, 5.5 mrad with it).
SEAM_MARGIN_RAD = 0.05


def step(previous: Array, r3: Array, r4: Array) -> tuple[Array, Estimate]:
    r"""Angles of one instant, with :math:`\sigma` the sign of the previous phi.

    .. math::
        \vartheta &= \mathrm{arctan2}(\sigma r_{3x}, -\sigma r_{3y}) \\
        \phi &= \sigma \arccos(r_{3z}) \\
        \psi &= \arcsin(r_{4x} c_\vartheta + r_{4y} s_\vartheta)

    and where :math:`\phi \approx 0` (right-hand)

    .. math::
        \vartheta &= \mathrm{arctan2}(r_{4x} s_\phi c_\psi + r_{4y} s_\psi,\; r_{4x} s_\psi - r_{4y} s_\phi c_\psi) \\
        \phi &= \arcsin(r_{3x} s_\vartheta - r_{3y} c_\vartheta)

    The right-hand formulas need psi: its size is the angle between r3 and r4, its sign the previous one. Where psi is
    near 0 as well (gimbal lock) theta is held.

    Args:
        previous: angles that this function returned last (theta unwrapped), or those of the setpoint in force.
        r3: unit vector along link 3, base frame.
        r4: unit vector along link 4, base frame.

    Returns:
        Angles for the next step, with theta up to the seam's margin beyond ±pi, and the estimate, with theta within it.
    """
    sigma = -1.0 if previous[2] < 0 else 1.0
    s_phi_size = math.hypot(r3[0], r3[1])
    psi_size = angle_between(r3, r4)
    theta_observable = True
    if s_phi_size >= THRESHOLD:
        theta = math.atan2(sigma * r3[0], -sigma * r3[1])
        phi = sigma * math.acos(clip1(float(r3[2])))
    elif math.sin(psi_size) >= THRESHOLD:
        s_psi, c_psi = math.copysign(math.sin(psi_size), previous[3]), math.cos(psi_size)
        theta, phi = _right_hand(r3, r4, sigma * s_phi_size, s_psi, c_psi)
        if phi * sigma < 0:  # phi went through 0 since: once more with its new sign
            theta, phi = _right_hand(r3, r4, -sigma * s_phi_size, s_psi, c_psi)
    else:
        theta, theta_observable = float(previous[0]), False
        phi = _phi(r3, theta)
    psi = math.asin(clip1(float(r4[0] * math.cos(theta) + r4[1] * math.sin(theta))))
    angles = _within_seam(_continued(np.array([theta, 0.0, phi, psi]), float(previous[0])))
    published = angles.copy()
    published[0] = np.clip(angles[0], -math.pi, math.pi)
    return angles, judge(NAME, published, (theta_observable, False, True, True), r3, r4)


def _right_hand(r3: Array, r4: Array, s_phi: float, s_psi: float, c_psi: float) -> tuple[float, float]:
    along = s_phi * c_psi
    theta = math.atan2(r4[0] * along + r4[1] * s_psi, r4[0] * s_psi - r4[1] * along)
    return theta, _phi(r3, theta)


def _phi(r3: Array, theta: float) -> float:
    return math.asin(clip1(float(r3[0] * math.sin(theta) - r3[1] * math.cos(theta))))


def _continued(angles: Array, previous_theta: float) -> Array:
    """The same positions by the set and the turn of theta that lie nearest to the previous theta."""
    half_turns = round((previous_theta - angles[0]) / math.pi)
    return _turned(angles, half_turns)


def _within_seam(angles: Array) -> Array:
    """The other set once theta has passed ±pi by more than the margin: the wrong one was chosen at the start."""
    if abs(angles[0]) <= math.pi + SEAM_MARGIN_RAD:
        return angles
    return _turned(angles, -int(math.copysign(1, angles[0])))


def _turned(angles: Array, half_turns: int) -> Array:
    """Theta turned by half turns; each negates the other angles and leaves every position as it is."""
    sign = -1.0 if half_turns % 2 else 1.0
    return np.array([angles[0] + half_turns * math.pi, 0.0, sign * angles[2], sign * angles[3]])
