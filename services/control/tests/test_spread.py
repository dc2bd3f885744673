import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from armsight_control.spread import inverse, is_positive, largest_variance


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-12, 6), st.floats(0, 6))
def test_the_largest_variance_is_the_largest_eigenvalue(seed: int, magnitude: float, decades: float) -> None:
    rng = np.random.default_rng(seed)
    directions, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    variances = 10**magnitude * np.array([1.0, 10 ** (-decades * rng.random()), 10**-decades])
    covariance = directions @ np.diag(variances) @ directions.T
    np.testing.assert_allclose(largest_variance(covariance), np.linalg.eigvalsh(covariance)[-1], rtol=1e-7)


def test_equal_and_vanishing_variances() -> None:
    assert largest_variance(np.eye(3) * 0.25) == 0.25
    assert largest_variance(np.zeros((3, 3))) == 0.0
    assert largest_variance(np.diag([1e-300, 0.0, 0.0])) >= 0.0
    np.testing.assert_allclose(largest_variance(np.diag([-1.0, 2.0, -3.0])), 2.0)


def test_the_inverse_of_a_covariance_is_numpys_even_where_it_is_vague_in_one_direction(
    rng: np.random.Generator,
) -> None:
    for vague_m in (0.003, 0.1, 10.0):
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        covariance = turn @ np.diag([0.003, 0.004, vague_m]) ** 2 @ turn.T
        found = np.array(inverse(covariance.tolist()))
        np.testing.assert_allclose(found @ covariance, np.eye(3), atol=1e-8)


def test_a_matrix_is_positive_where_all_of_its_eigenvalues_are(rng: np.random.Generator) -> None:
    for _ in range(200):
        matrix = rng.normal(size=(3, 3))
        matrix = matrix + matrix.T + 2.0 * np.eye(3)
        assert is_positive(matrix.tolist()) == (np.linalg.eigvalsh(matrix)[0] > 0)
