r"""A chain reduced to the joints that may move: what solvers and batched kinematics compute with.

Every joint turns about the z-axis of a frame of its own, and every link between two of them is a translation and a
turn about x, so that a joint costs a sine, a cosine and some twenty multiplications, whatever its axis is:

.. math:: p_{base} = o + R\, R_z(u_1)\,(t_1 + R_x(\alpha_1)\, R_z(u_2)\,(t_2 + \dots R_z(u_n)\, t_n))
    \quad \text{with} \quad u = q + offset

Joints that stay where they are become part of the links.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from armsight_control.chain import Array, Chain
from armsight_control.errors import SolverError
from armsight_control.kinematics import frames, position

# Below this sine two axes count as parallel, and any common perpendicular will do.
_PARALLEL = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Folded:
    """The n joints that may move, in order from the base."""

    free: tuple[int, ...]
    """Their indices in the chain."""
    R_base_first: Array
    """(3, 3): turns vectors of the first moving joint's frame, at u = 0, into the base frame."""
    p_base_first: Array
    """(3,): that frame's origin."""
    offsets: Array
    """(n,): added to a joint's angle."""
    links: Array
    """(n, 5): x, y, z, cos alpha and sin alpha to the next joint; of the last one x, y, z of the tip."""
    limits: Array
    """(n, 2): lower and upper, of u = q + offset."""
    levers: Array
    """(n,): upper bounds of the tip's distance from each axis, metres."""

    def to_first(self, points: Array) -> Array:
        """Points (..., 3) of the base frame in the first moving joint's frame."""
        return np.asarray((points - self.p_base_first) @ self.R_base_first)

    def tips(self, q: Array) -> Array:
        """The tip (m, 3) in the base frame at angles (m, n) of the free joints: coordinate by coordinate.

        For hundreds of configurations a sixth of the time of :func:`~armsight_control.kinematics.forward`.
        """
        turns = (q + self.offsets).T
        x, y, z = (np.full(len(q), each) for each in self.links[-1, :3])
        for i in reversed(range(len(turns))):
            s, c = np.sin(turns[i]), np.cos(turns[i])
            x, y = c * x - s * y, s * x + c * y
            if i > 0:
                along, across, up, cosine, sine = self.links[i - 1].tolist()
                x, y, z = along + x, across + cosine * y - sine * z, up + sine * y + cosine * z
        return np.asarray(np.stack([x, y, z], axis=1) @ self.R_base_first.T + self.p_base_first)


@lru_cache(maxsize=64)
def fold(chain: Chain, free: tuple[int, ...], held: tuple[float, ...]) -> Folded:
    """Reduces a chain to its free joints.

    Args:
        chain: the arm.
        free: indices of the joints that may move; in any order.
        held: the angles of the others, in the chain's order.

    Raises:
        SolverError: no joint is free, one is named twice or is none of the chain's.
    """
    check_free(chain, free)
    free = tuple(sorted(free))
    q = np.zeros(chain.count)
    q[[i for i in range(chain.count) if i not in free]] = held
    rotations, origins = frames(chain, q)
    axes = [rotations[i + 1] @ chain.axes[i] for i in free]
    places = [*(origins[i + 1] for i in free), position(chain, q, chain.tip)]
    n = len(free)
    offsets, links = np.zeros(n), np.zeros((n, 5))
    links[:, 3] = 1.0
    before = first = _frame(axes[0], _perpendicular(axes[0], axes[1] if n > 1 else axes[0], None))
    for i in range(n):
        after = before
        if i + 1 < n:
            x = _perpendicular(axes[i], axes[i + 1], before[:, 0])
            after, following = _frame(axes[i], x), _frame(axes[i + 1], x)
            offsets[i] = np.arctan2(x @ before[:, 1], x @ before[:, 0])
            links[i, 3:] = axes[i] @ axes[i + 1], -(after[:, 1] @ axes[i + 1])
            before = following
        links[i, :3] = after.T @ (places[i + 1] - places[i])
    lengths = np.linalg.norm(links[:, :3], axis=1)
    across = np.hypot(links[:, 0], links[:, 1])
    levers = across + np.append(np.cumsum(lengths[::-1])[::-1][1:], 0.0)
    limits = chain.limits[list(free)] + offsets[:, None]
    return Folded(free, first, places[0], offsets, links, limits, levers)


def check_free(chain: Chain, free: tuple[int, ...]) -> None:
    """Refuses a choice of joints that the chain doesn't have.

    Raises:
        SolverError: says which.
    """
    wrong = [str(i) for i in free if not 0 <= i < chain.count]
    if wrong or not free or len(set(free)) < len(free):
        said = f"index {', '.join(wrong)}" if wrong else "none" if not free else "one of them twice"
        raise SolverError(f"free joints: {said}; expected some of 0 to {chain.count - 1}, each once")


def _frame(z: Array, x: Array) -> Array:
    return np.stack([x, np.cross(z, x), z], axis=1)


def _perpendicular(z: Array, following: Array, rather: Array | None) -> Array:
    """A unit vector at right angles to two axes; ``rather`` where they are parallel."""
    x = np.cross(z, following)
    length = np.linalg.norm(x)
    if length > _PARALLEL:
        return np.asarray(x / length)
    if rather is not None:
        return rather
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    return np.asarray(x / np.linalg.norm(x))
