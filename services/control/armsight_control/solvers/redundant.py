r"""Exact inverse kinematics of the report's arm with all four joints: a family of solutions for every target.

With :math:`tip = R_z(\vartheta) R_y(\nu) R_x(\phi)\,(a, 0, b)`, :math:`a = L_4 s_\psi` and
:math:`b = L_3 + L_4 c_\psi`, the distance from the shoulder fixes :math:`|\psi|`. For each nu the height h over the
shoulder then gives

.. math:: c_\phi = (h + s_\nu a) / (c_\nu b),

and the azimuth theta. What remains free is nu, within an interval for each sign of psi: :math:`c_\phi \le 1` is
:math:`\nu + \delta \in \pm\arccos(h/d)` with :math:`\delta = atan2(a, b)`, d the distance, and :math:`c_\phi \ge 0` is
:math:`s_\nu a \ge -h`. The two signs of phi make two halves of it. Of the family that configuration is taken which is
least motion from the present one; where several are, the one farthest from the limits.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight_control.chain import Array
from armsight_control.kinematics import Links
from armsight_control.solvers.options import ClosedFormOptions
from armsight_control.solvers.workspace import TOLERANCE_M

_QUARTER = math.pi / 2
_PSI_SIGNS = np.array([1.0, 1.0, -1.0, -1.0])[:, None]
_PHI_SIGNS = np.array([1.0, -1.0, 1.0, -1.0])[:, None]
# Each zoom divides the bracket by eight; after eight of them it is narrower than a minimum can be told in float64.
_ZOOMS, _ZOOM_SAMPLES = 8, np.linspace(-1.0, 1.0, 17)


@dataclass(frozen=True, slots=True)
class Family:
    """The solutions of m targets in four parts, one for each pair of signs of psi and phi: arrays (m, 4, 1)."""

    a: Array
    """L4 sin psi, with its sign."""
    b: Array
    psi: Array
    h: Array
    azimuth: Array
    off_axis: NDArray[np.bool_]
    """False for targets on the z-axis, where any theta is right and `azimuth` holds the start's."""
    middle: Array
    """Of nu's interval."""
    half: Array
    """Of its width."""

    def at(self, t: Array) -> Array:
        """Configurations (m, 4, k, 4) at parameters (m, 4, k) from -pi/2 to pi/2.

        nu is middle + half sin t, which makes phi smooth where the two halves meet.
        """
        nu = self.middle + self.half * np.sin(t)
        s_nu, c_nu = np.sin(nu), np.cos(nu)
        c_phi = np.clip((self.h + s_nu * self.a) / (np.maximum(c_nu, 1e-300) * self.b), 0.0, 1.0)
        phi = _PHI_SIGNS * np.arccos(c_phi)
        x, y = c_nu * self.a + s_nu * np.cos(phi) * self.b, -np.sin(phi) * self.b
        theta = self.azimuth - np.where(self.off_axis, np.arctan2(y, x), 0.0)
        theta -= 2 * math.pi * np.round(theta / (2 * math.pi))
        return np.stack([theta, nu, phi, np.broadcast_to(self.psi, nu.shape)], axis=-1)


def family_of(links: Links, targets: Array, theta_on_axis: Array) -> Family:
    """All solutions.

    Args:
        links: the lengths.
        targets: (m, 3), base frame, metres, reachable.
        theta_on_axis: (m,), theta for targets on the z-axis.
    """
    x, y, h = (part[:, None, None] for part in (targets[:, 0], targets[:, 1], targets[:, 2] - links.l1))
    rho = np.hypot(x, y)
    distance = np.hypot(rho, h)
    c = np.clip((distance**2 - links.l3**2 - links.l4**2) / (2 * links.l3 * links.l4), 0.0, 1.0)
    across, b = links.l4 * np.sqrt(1 - c * c), links.l3 + links.l4 * c
    # for psi above 0; its mirror image, nu to -nu, is for psi below
    delta, opening = np.arctan2(across, b), np.arccos(np.clip(h / distance, -1.0, 1.0))
    hanging = np.arcsin(np.clip(-h / np.maximum(across, 1e-300), -1.0, 1.0))
    lower = np.maximum(np.maximum(-_QUARTER, -delta - opening), hanging)
    upper = np.maximum(np.minimum(_QUARTER, opening - delta), lower)
    off_axis = rho > TOLERANCE_M
    return Family(
        a=_PSI_SIGNS * across,
        b=b,
        psi=_PSI_SIGNS * np.arctan2(across, links.l4 * c),
        h=h,
        azimuth=np.where(off_axis, np.arctan2(y, x), theta_on_axis[:, None, None]),
        off_axis=off_axis,
        middle=_PSI_SIGNS * (lower + upper) / 2,
        half=(upper - lower) / 2,
    )


def solve(links: Links, limits: Array, targets: Array, starts: Array, options: ClosedFormOptions) -> Array:
    """The solutions (m, 4) of least motion.

    Args:
        links: the lengths.
        limits: (4, 2).
        targets: (m, 3), base frame, metres, reachable.
        starts: (m, 4).
        options: how finely the family is searched.
    """
    family = family_of(links, targets, starts[:, 0])
    spread = np.linspace(-_QUARTER, _QUARTER, options.samples)
    own = np.arcsin(np.clip((starts[:, None, 1:2] - family.middle) / np.maximum(family.half, 1e-12), -1.0, 1.0))
    t = np.concatenate([np.broadcast_to(spread, (*own.shape[:2], options.samples)), own], axis=2)
    best, _, _ = _least_motion(family, t, starts)
    width = math.pi / (options.samples - 1)
    for _ in range(_ZOOMS):
        t = np.clip(best + width * _ZOOM_SAMPLES, -_QUARTER, _QUARTER)
        best, q, motion = _least_motion(family, t, starts)
        width /= (len(_ZOOM_SAMPLES) - 1) / 2
    room = np.minimum(q - limits[:, 0], limits[:, 1] - q).min(axis=-1)
    tied = motion <= motion.min(axis=1, keepdims=True) + options.tie_rad
    chosen = np.where(tied, room, -np.inf).argmax(axis=1)
    return np.asarray(q[np.arange(len(q)), chosen])


def _least_motion(family: Family, t: Array, starts: Array) -> tuple[Array, Array, Array]:
    """Of each part the best parameter (m, 4, 1), its configuration (m, 4, 4) and how far that is (m, 4)."""
    q = family.at(t)
    motion = np.sqrt(((q - starts[:, None, None, :]) ** 2).sum(axis=-1))
    best = motion.argmin(axis=2)[..., None]
    chosen = np.take_along_axis(q, best[..., None], axis=2)[:, :, 0]
    return np.take_along_axis(t, best, axis=2), chosen, np.take_along_axis(motion, best, axis=2)[..., 0]
