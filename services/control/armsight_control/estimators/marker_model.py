r"""Where the markers of any serial chain are, and how they move with its joints: all of them in one pass.

They are :mod:`..kinematics`' own, with every joint's frame computed once for all points.
"""

from dataclasses import dataclass

import numpy as np

from armsight_control.chain import Array
from armsight_control.description import Arm
from armsight_control.kinematics import points_and_columns


@dataclass(frozen=True, slots=True)
class Placed:
    """The points of a model at one configuration; base frame, metres and radians."""

    points: Array
    """(points, 3)."""
    jacobians: Array
    """(points, 3, joints)."""


class MarkerModel:
    """The markers that move when the joints do, in the order of ``names``, and the tip after them."""

    def __init__(self, arm: Arm) -> None:
        """Derives from the description what does not change with the angles."""
        self.chain = chain = arm.chain
        self._take(tuple(arm.markers), arm)
        # a marker on the axes of all joints that carry it (green) tells nothing of any angle
        poses = np.random.default_rng(0).uniform(chain.limits[:, 0], chain.limits[:, 1], size=(4, chain.count))
        moved = np.max([np.abs(self.at(q).jacobians) for q in poses], axis=(0, 2, 3))[:-1]
        self._take(tuple(name for name, most in zip(arm.markers, moved, strict=True) if most > 1e-9), arm)

    def _take(self, names: tuple[str, ...], arm: Arm) -> None:
        self.names = names
        self.index = {name: i for i, name in enumerate(names)}
        self._points = [*(arm.markers[name] for name in names), arm.chain.tip]

    def at(self, q: Array) -> Placed:
        """Everything at the angles ``q``, (joints,), in radians; limits are not checked here."""
        points, columns = zip(*points_and_columns(self.chain, q, self._points), strict=True)
        return Placed(np.array(points), np.array(columns).transpose(0, 2, 1))
