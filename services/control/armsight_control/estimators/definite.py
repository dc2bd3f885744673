"""Small symmetric positive definite systems in plain floats: numpy's call costs more than what it computes here."""

from collections.abc import Sequence

from armsight_control.chain import Rows


def solved(matrix: Rows, right: Sequence[float]) -> list[float]:
    r"""The x of :math:`A x = b`, by the factors :math:`A = L D L^T` (Golub and Van Loan, Matrix Computations, 4.1).

    Args:
        matrix: A, of which the lower triangle is not read.
        right: b.

    Raises:
        ZeroDivisionError: A is singular.
    """
    n, x = len(right), list(right)
    upper = [list(row) for row in matrix]  # becomes D L^T
    for i, row in enumerate(upper):
        for j in range(i + 1, n):
            factor, below = row[j] / row[i], upper[j]
            x[j] -= factor * x[i]
            for k in range(j, n):
                below[k] -= factor * row[k]
    for i in range(n - 1, -1, -1):
        row = upper[i]
        for k in range(i + 1, n):
            x[i] -= row[k] * x[k]
        x[i] /= row[i]
    return x
