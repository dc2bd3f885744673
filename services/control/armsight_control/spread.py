"""Covariances of points in plain floats: numpy's calls on a 3 x 3 cost ten times what they compute."""

import math

import numpy as np

from armsight_control.chain import Array, Rows


def is_positive(covariance: Rows) -> bool:
    """Whether a symmetric 3 x 3 matrix has no direction of negative variance: by its pivots; all zero will do."""
    (a, b, c), (_, d, e), (_, _, f) = covariance
    if a == b == c == d == e == f == 0:
        return True
    if not a > 0:
        return False
    second, between = d - b * b / a, e - b * c / a
    return second > 0 and f - c * c / a - between * between / second > 0


def inverse(covariance: Rows) -> Rows:
    r"""Of a symmetric positive 3 x 3 matrix, of which the lower triangle is not read.

    By :math:`L^{-T} D^{-1} L^{-1}` of its factors :math:`L D L^T`: by cofactors and determinant the inverse of a
    covariance that is vague in one direction would be lost in rounding (Higham, Accuracy and Stability of Numerical
    Algorithms, 2002, chapters 10 and 14).
    """
    (a, b, c), (_, d, e), (_, _, f) = covariance
    l10, l20 = b / a, c / a
    second, between = d - l10 * b, e - l20 * b
    l21 = between / second
    third = f - l20 * c - l21 * between
    m20 = l10 * l21 - l20  # of the inverse of L
    xz, yz, zz = m20 / third, -l21 / third, 1.0 / third
    xy, yy = m20 * yz - l10 / second, 1.0 / second - l21 * yz
    return (1.0 / a + l10 * l10 / second + m20 * xz, xy, xz), (xy, yy, yz), (xz, yz, zz)


def largest_variance(covariance: Array | Rows) -> float:
    """The largest eigenvalue of a symmetric 3 x 3 matrix, of which the lower triangle is not read.

    By the cosine of a third of an angle (Smith, Eigenvalues of a symmetric 3 x 3 matrix, 1961).
    """
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = covariance.tolist() if isinstance(covariance, np.ndarray) else covariance
    mean = (xx + yy + zz) / 3.0
    x, y, z = xx - mean, yy - mean, zz - mean
    off = xy * xy + xz * xz + yz * yz
    scale = math.sqrt((x * x + y * y + z * z + 2.0 * off) / 6.0)
    if scale <= 1e-150:  # a multiple of the identity; what is divided by its cube would underflow
        return float(mean)
    half_determinant = (x * (y * z - yz * yz) - xy * (xy * z - yz * xz) + xz * (xy * yz - y * xz)) / 2.0
    cosine = max(-1.0, min(1.0, half_determinant / scale**3))
    return float(mean + 2.0 * scale * math.cos(math.acos(cosine) / 3.0))
