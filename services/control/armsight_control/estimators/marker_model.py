r"""Where the markers of any serial chain are, and how they move with its joints: all of them in one pass.

Column i of a point's Jacobian is :math:`z_i \times (p - o_i)` for the joints that carry it (:mod:`..kinematics`, which
says the same for batches, one point at a time).
"""

from dataclasses import dataclass

import numpy as np

from armsight_control.chain import Array
from armsight_control.description import Arm


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
        chain = arm.chain
        self.chain = chain
        self._crosses = np.array([[[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]] for x, y, z in chain.axes])
        self._squares = self._crosses @ self._crosses
        self._take(tuple(arm.markers), arm)
        # a marker on the axes of all joints that carry it (green) tells nothing of any angle
        poses = np.random.default_rng(0).uniform(chain.limits[:, 0], chain.limits[:, 1], size=(4, chain.count))
        moved = np.max([np.abs(self.at(q).jacobians) for q in poses], axis=(0, 2, 3))[:-1]
        self._take(tuple(name for name, most in zip(arm.markers, moved, strict=True) if most > 1e-9), arm)

    def _take(self, names: tuple[str, ...], arm: Arm) -> None:
        points = [*(arm.markers[name] for name in names), arm.chain.tip]
        self.names = names
        self.index = {name: i for i, name in enumerate(names)}
        self._frame = np.array([point.joint + 1 for point in points])
        self._local = np.array([point.position for point in points])[:, :, None]
        self._carried = (np.arange(arm.chain.count) < self._frame[:, None]).astype(np.float64)

    def at(self, q: Array) -> Placed:
        """Everything at the angles ``q``, (joints,), in radians; limits are not checked here."""
        chain = self.chain
        turns = np.eye(3) + np.sin(q)[:, None, None] * self._crosses + (1 - np.cos(q))[:, None, None] * self._squares
        rotations = np.empty((chain.count + 1, 3, 3))
        origins = np.empty((chain.count + 1, 3))
        axes = np.empty((3, chain.count))
        rotations[0], origins[0] = np.eye(3), 0.0
        for i in range(chain.count):
            before = rotations[i]
            origins[i + 1] = origins[i] + before @ chain.origins[i]
            axes[:, i] = before @ chain.axes[i]
            rotations[i + 1] = before @ turns[i]
        points = origins[self._frame] + (rotations[self._frame] @ self._local)[:, :, 0]
        x, y, z = axes
        dx, dy, dz = (points[:, k, None] - origins[None, 1:, k] for k in range(3))
        jacobians = np.empty((len(points), 3, chain.count))
        jacobians[:, 0] = y * dz - z * dy
        jacobians[:, 1] = z * dx - x * dz
        jacobians[:, 2] = x * dy - y * dx
        jacobians *= self._carried[:, None, :]
        return Placed(points, jacobians)
