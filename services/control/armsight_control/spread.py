"""The worst direction of a covariance, in plain floats: numpy's calls on a 3 x 3 cost ten times what they compute."""

import math

from armsight_control.chain import Array


def largest_variance(covariance: Array) -> float:
    """The largest eigenvalue of a symmetric 3 x 3 matrix, of which the lower triangle is not read.

    By the cosine of a third of an angle (Smith, Eigenvalues of a symmetric 3 x 3 matrix, 1961).
    """
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = covariance.tolist()
    mean = (xx + yy + zz) / 3.0
    x, y, z = xx - mean, yy - mean, zz - mean
    off = xy * xy + xz * xz + yz * yz
    scale = math.sqrt((x * x + y * y + z * z + 2.0 * off) / 6.0)
    if scale <= 1e-150:  # a multiple of the identity; what is divided by its cube would underflow
        return float(mean)
    half_determinant = (x * (y * z - yz * yz) - xy * (xy * z - yz * xz) + xz * (xy * yz - y * xz)) / 2.0
    cosine = max(-1.0, min(1.0, half_determinant / scale**3))
    return float(mean + 2.0 * scale * math.cos(math.acos(cosine) / 3.0))
