r"""Configurations from one instant's markers alone: where to look for the angles when the prediction is no good.

For the report's arm in closed form. With :math:`R = R_z(\vartheta) R_y(\nu) R_x(\phi)`, :math:`r_3 = R e_z` and
:math:`r_4 = R R_y(\psi) e_z`:

.. math::
    r_3 \cdot r_4 = c_\psi, \quad r_3 \times r_4 = s_\psi\, R e_y

so that each sign of :math:`\psi` gives one R, and R its Euler angles. The two are twins,
(theta ± pi, -nu, -phi, -psi). Where :math:`\psi \approx 0` the turn about :math:`r_3` is left open and yellow's offset,
:math:`(s_\nu c_\vartheta, s_\nu s_\vartheta, c_\nu)` above the shoulder, closes it.

For any other arm: the same few configurations every time, spread over its limits.
"""

import math
from collections.abc import Iterable

import numpy as np

from armsight_control.chain import Array, Chain, Point
from armsight_control.description import Arm
from armsight_control.errors import PositionsError, UnsupportedArmError
from armsight_control.kinematics import links_of
from armsight_control.positions import LastLinks, Positions, directions_of, last_links_of

# Twins on both sides of joint 1's seam are candidates: noise may take the right one a little beyond its end.
_SEAM_RAD = 0.05
_SEEDED = 12


class Candidates:
    """Derived once from the description."""

    def __init__(self, arm: Arm) -> None:
        """Finds out whether the closed form applies."""
        self._chain = arm.chain
        self._links: LastLinks | None
        try:
            links_of(arm.chain)
            self._links = last_links_of(arm)
        except UnsupportedArmError:
            self._links = None
        self._pointer = _pointer(arm)
        limits = arm.chain.limits
        self._seeded = np.random.default_rng(0).uniform(limits[:, 0], limits[:, 1], size=(_SEEDED, arm.chain.count))

    def of(self, positions: Positions) -> list[Array]:
        """Within the limits; where the closed form needs a marker that is lost, the spread ones."""
        if self._links is None:
            return list(self._seeded)
        try:
            found = directions_of(positions, self._links)
        except (PositionsError, np.linalg.LinAlgError):
            return list(self._seeded)
        branches = [from_frame(found.r3, found.r4)]
        if self._pointer is not None and self._pointer[0] in positions.seen:
            arrow = positions.seen[self._pointer[0]].position - self._pointer[1]
            branches.append(from_pointer(arrow, found.r3, found.r4))
        return list(within(self._chain, [q for branch in branches for q in (branch, *twins(branch))]))


def from_frame(r3: Array, r4: Array) -> Array:
    """The branch with psi from 0 to pi: joint 4's axis across both links gives R, R its Euler angles."""
    across = np.array(
        [r3[1] * r4[2] - r3[2] * r4[1], r3[2] * r4[0] - r3[0] * r4[2], r3[0] * r4[1] - r3[1] * r4[0]], dtype=np.float64
    )
    size = math.sqrt(float(across @ across))
    y = across / size if size > 1e-9 else _any_across(r3)
    x = np.array([y[1] * r3[2] - y[2] * r3[1], y[2] * r3[0] - y[0] * r3[2], y[0] * r3[1] - y[1] * r3[0]])
    nu = math.asin(min(1.0, max(-1.0, -float(x[2]))))
    return np.array([math.atan2(x[1], x[0]), nu, math.atan2(y[2], r3[2]), math.atan2(size, float(r3 @ r4))])


def from_pointer(arrow: Array, r3: Array, r4: Array) -> Array:
    """The branch with nu from 0 to pi: yellow, ``arrow`` from the shoulder, gives theta and nu, the links the rest."""
    nu = math.atan2(math.hypot(arrow[0], arrow[1]), arrow[2])
    theta = math.atan2(arrow[1], arrow[0])
    turned3, turned4 = (_unturned(r, theta, nu) for r in (r3, r4))
    phi = math.atan2(-turned3[1], turned3[2])
    along = math.cos(phi) * turned4[2] - math.sin(phi) * turned4[1]
    return np.array([theta, nu, phi, math.atan2(turned4[0], along)])


def twins(q: Array) -> tuple[Array, Array]:
    """(theta ± pi, -nu, -phi, -psi): the same positions."""
    return np.array([q[0] - math.pi, *-q[1:]]), np.array([q[0] + math.pi, *-q[1:]])


def within(chain: Chain, candidates: Iterable[Array]) -> Iterable[Array]:
    """Those within the limits, or so little beyond that noise explains it, clipped."""
    low, high = chain.limits[:, 0] - _SEAM_RAD, chain.limits[:, 1] + _SEAM_RAD
    return (chain.clip(q) for q in candidates if ((q >= low) & (q <= high)).all())


def _pointer(arm: Arm) -> tuple[str, Array] | None:
    """A marker that joints 1 and 2 alone turn, and the shoulder that it points away from."""
    for name, point in arm.markers.items():
        if point.joint == 1 and _on_z(point):
            return name, arm.chain.origins[0] + arm.chain.origins[1]
    return None


def _on_z(point: Point) -> bool:
    return bool(point.position[2] > 0 and np.abs(point.position[:2]).max() < 1e-6)


def _any_across(unit: Array) -> Array:
    across = np.zeros(3)
    across[int(np.argmin(np.abs(unit)))] = 1.0
    across -= (across @ unit) * unit
    return np.asarray(across / math.sqrt(float(across @ across)))


def _unturned(r: Array, theta: float, nu: float) -> Array:
    """Ry(-nu) Rz(-theta) r."""
    (s_theta, c_theta), (s_nu, c_nu) = ((math.sin(a), math.cos(a)) for a in (theta, nu))
    x, y = c_theta * r[0] + s_theta * r[1], -s_theta * r[0] + c_theta * r[1]
    return np.array([c_nu * x - s_nu * r[2], y, s_nu * x + c_nu * r[2]])
