r"""The report's Part I: joint 1 fixed at 0, unknown nu, phi and psi.

.. math::
    r_3 &= (c_\phi s_\nu,\; -s_\phi,\; c_\phi c_\nu) \\
    r_4 &= (c_\nu s_\psi + s_\nu c_\phi c_\psi,\; -s_\phi c_\psi,\; -s_\nu s_\psi + c_\nu c_\phi c_\psi)
"""

import math

import numpy as np

from armsight_control.chain import Array
from armsight_control.estimators.estimate import Estimate, angle_between, clip1, judge

NAME = "part1"
FIXED_JOINT = 0

# Below this cos(phi) nu is taken from r4, and held where sin(psi) is below it too: with 0.02 or 0.35 the largest error
# over the report's motion is 70 or 35 mrad, with 0.1 it is 11.
THRESHOLD = 0.1


def step(previous: Array, r3: Array, r4: Array) -> tuple[Array, Estimate]:
    r"""Angles of one instant.

    .. math::
        \phi &= \arcsin(-r_{3y}) \\
        \nu &= \mathrm{arctan2}(r_{3x}, r_{3z}), \text{ or where } \phi \approx \pm\pi/2 \text{ (right-hand)} \\
        \nu &= \mathrm{arctan2}(r_{4x} c_\phi c_\psi - r_{4z} s_\psi,\; r_{4x} s_\psi + r_{4z} c_\phi c_\psi) \\
        \psi &= \arcsin(r_{4x} c_\nu - r_{4z} s_\nu)

    The right-hand formula needs psi: its size is the angle between r3 and r4, its sign the previous one. Where psi is
    near 0 as well (gimbal lock) any nu gives the same positions: the previous value is held.

    Args:
        previous: angles that this function returned last, or those of the setpoint in force.
        r3: unit vector along link 3, base frame.
        r4: unit vector along link 4, base frame.
    """
    phi = math.asin(clip1(float(-r3[1])))
    c_phi = math.hypot(r3[0], r3[2])
    psi_size = angle_between(r3, r4)
    nu_observable = True
    if c_phi >= THRESHOLD:
        nu = math.atan2(r3[0], r3[2])
    elif math.sin(psi_size) >= THRESHOLD:
        s_psi, c_psi = math.copysign(math.sin(psi_size), previous[3]), math.cos(psi_size)
        nu = math.atan2(r4[0] * c_phi * c_psi - r4[2] * s_psi, r4[0] * s_psi + r4[2] * c_phi * c_psi)
    else:
        nu, nu_observable = float(previous[1]), False
    psi = math.asin(clip1(float(r4[0] * math.cos(nu) - r4[2] * math.sin(nu))))
    angles = np.array([0.0, nu, phi, psi])
    return angles, judge(NAME, angles, (False, nu_observable, True, True), r3, r4)
