import numpy as np
import pytest

from armsight_control.estimators.definite import solved


@pytest.mark.parametrize("joints", [1, 2, 4, 7])
def test_a_positive_definite_system_is_solved_as_numpy_does(joints: int, rng: np.random.Generator) -> None:
    for spread in (1.0, 1e3, 1e6):
        factor = rng.normal(size=(joints, joints)) * np.geomspace(1.0, 1.0 / spread, joints)
        matrix, x = factor @ factor.T + 1e-3 / spread**2 * np.eye(joints), rng.normal(size=joints)
        found = solved(matrix.tolist(), (matrix @ x).tolist())
        np.testing.assert_allclose(matrix @ found, matrix @ x, atol=1e-12 * np.abs(matrix).max())
