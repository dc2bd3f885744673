r"""Where the markers of any serial chain are, and how they move with its joints: all of them in one pass.

They are :mod:`..kinematics`' own, with every joint's frame computed once for all points.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armsight_control.chain import Array, Triple
from armsight_control.description import Arm
from armsight_control.kinematics import points_and_columns


@dataclass(frozen=True)
class Placed:
    """The points of a model at one configuration; base frame, metres and radians."""

    found: Sequence[tuple[Triple, Sequence[Triple]]]
    """Each point with the columns of its Jacobian, one for every joint, in plain floats."""

    @cached_property
    def points(self) -> Array:
        """(points, 3)."""
        return np.array([point for point, _ in self.found])

    @cached_property
    def jacobians(self) -> Array:
        """(points, 3, joints)."""
        return np.array([columns for _, columns in self.found]).transpose(0, 2, 1)


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

    def at(self, q: Array | Sequence[float]) -> Placed:
        """Everything at the angles ``q``, (joints,), in radians; limits are not checked here."""
        return Placed(list(points_and_columns(self.chain, q, self._points)))
