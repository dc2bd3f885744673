r"""Motion of the joints that the tip does not see, and how near the arm is to where it loses a direction.

With four joints free and three coordinates to keep there is one motion of the joints that leaves the tip where it is.
It is spent on getting away from limits and singularities: the gradient of a cost of both, projected on the Jacobian's
null space (Liégeois, Automatic Supervisory Control of the Configuration and Behavior of Multibody Mechanisms, 1977).
"""

from collections.abc import Sequence

import numpy as np

from armsight_control.chain import Array, Chain, Triple
from armsight_control.kinematics import jacobian
from armsight_control.spread import is_positive

DAMPING_M = 0.05
"""Metres per radian, of an arm of 10 m: below this a direction of the tip costs more joint speed than it is worth."""
# The weight of singularities beside that of limits: to lose half of the best manipulability costs as much as a joint
# half way to its limit.
_SINGULAR_WEIGHT = 0.3
_DIFFERENCE_RAD = 1e-5
# The cost changes by about 1 for a radian: it is followed down within a second or two, never faster than a fifth of
# the arm's speed, which the target needs.
_RATE_RAD2_S = 0.5
_MOST_RAD_S = 0.3


def damped_inverse(by_joint: Array, damping_m: float = DAMPING_M) -> Array:
    r"""The n x 3 inverse :math:`J^T (J J^T + \lambda^2 I)^{-1}` of a 3 x n Jacobian (Wampler, 1986; Nakamura, 1986).

    The damping grows from 0 only where the smallest singular value falls below ``damping_m``, so that away from
    singularities nothing is lost: :math:`\lambda^2 = \lambda_{max}^2 (1 - (\sigma_{min}/\lambda_{max})^2)`.
    """
    left, sigma, right = np.linalg.svd(by_joint, full_matrices=False)
    damping2 = max(0.0, damping_m**2 - float(sigma[-1]) ** 2)
    return np.asarray((right.T * (sigma / (sigma**2 + damping2))) @ left.T)


def smallest_singular_value(by_joint: Array) -> float:
    """Metres per radian in the direction in which the tip moves least: 0 in a singularity."""
    return float(np.linalg.svd(by_joint, compute_uv=False)[-1])


def least_moved(columns: Sequence[Triple], most_m: float) -> float:
    r"""The smallest singular value of a Jacobian of these columns, or ``most_m`` where it is more than that.

    It is more where :math:`J J^T - most^2 I` is positive: that takes a tenth of the singular values' time.
    """
    xx = yy = zz = -most_m * most_m
    xy = xz = yz = 0.0
    for x, y, z in columns:
        xx, xy, xz, yy, yz, zz = xx + x * x, xy + x * y, xz + x * z, yy + y * y, yz + y * z, zz + z * z
    if is_positive(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))):
        return most_m
    return min(most_m, smallest_singular_value(np.array(columns).T))


def cost(chain: Chain, q: Array, free: tuple[int, ...]) -> float:
    r"""How near the free joints are to their limits, and the arm to a singularity; no unit.

    :math:`\sum_i (2 (q_i - m_i)/(u_i - l_i))^2 / n - w \log \sqrt{\det J J^T}`, with m the middle of the limits.
    """
    lower, upper = chain.limits[list(free)].T
    away = (2 * q[list(free)] - lower - upper) / (upper - lower)
    by_joint = jacobian(chain, q)[:, free]
    manipulability = np.sqrt(max(float(np.linalg.det(by_joint @ by_joint.T)), 1e-12))
    return float(away @ away) / len(free) - _SINGULAR_WEIGHT * float(np.log(manipulability))


def null_motion(chain: Chain, q: Array, by_joint: Array, free: tuple[int, ...]) -> Array:
    """Joint speeds that lower the cost and leave the tip where it is, to first order.

    Args:
        chain: the arm.
        q: all joints, radians.
        by_joint: 3 x len(free), of the tip by the free joints.
        free: the joints that may move.

    Returns:
        One value for each free joint, rad/s; zeros where the Jacobian leaves nothing over.
    """
    if len(free) <= by_joint.shape[0]:
        return np.zeros(len(free))
    _, sigma, right = np.linalg.svd(by_joint)
    rank = int((sigma > 1e-6).sum())
    motion = np.zeros(len(free))
    for direction in right[rank:]:
        step = np.zeros(chain.count)
        step[list(free)] = _DIFFERENCE_RAD * direction
        slope = (cost(chain, q + step, free) - cost(chain, q - step, free)) / (2 * _DIFFERENCE_RAD)
        motion -= _RATE_RAD2_S * slope * direction
    largest = float(np.abs(motion).max())
    return np.asarray(motion * min(1.0, _MOST_RAD_S / largest) if largest > 0 else motion)
