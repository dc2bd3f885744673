r"""The angles that explain all markers and what was known before best, within the limits.

.. math::
    \min_q \; \tfrac{1}{k} \sum_i \rho\big(\lVert p_i(q) - z_i \rVert^2_{C_i + f^2 I}\big)
        + (q - \bar q)^T \Lambda (q - \bar q)

with Huber's :math:`\rho`: a marker whose covariance denies its error counts for less. :math:`\bar q, \Lambda` are mean
and information of the prior, :math:`f` the floor and :math:`k` the number of readings that are worth one.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight_control.chain import Array
from armsight_control.estimators.marker_model import MarkerModel, Placed
from armsight_control.positions import Positions

# Systematic errors that no covariance of a single frame knows: of the lens' and sphere's model, one camera pixel being
# 38 mm. It keeps a marker that claims micrometres from outweighing all others.
FLOOR_M = 1e-3
_FLOOR = np.eye(3) * FLOOR_M**2
# Normalised errors of more than this are not of the stated distribution (0.1 % of three normal variables are beyond).
_HUBER_SIGMAS = 4.0
# No step is longer: from far away the linear model is wrong.
_LONGEST_STEP_RAD = 0.5
# What is left after a step of this length is its square: a millionth.
_CONVERGED_RAD = 1e-3


@dataclass(frozen=True, slots=True)
class Readings:
    """The markers that were seen at one instant, as arrays."""

    rows: NDArray[np.intp]
    """Their indices in the model."""
    points: Array
    """(markers, 3), base frame, metres."""
    weights: Array
    """(markers, 3, 3): inverse covariances, floor included, 1/m²."""
    spreads: Array
    """(markers,): standard deviation, all directions together, metres."""


@dataclass(frozen=True, slots=True)
class Belief:
    """A normal distribution of the angles."""

    mean: Array
    information: Array
    """Inverse covariance, joints x joints."""


@dataclass(frozen=True, slots=True)
class Fit:
    """The best angles and what they rest on."""

    q: Array
    information: Array
    """Of markers and prior together."""
    misfit: float
    """Squared errors of the markers, normalised by their covariances: chi squared of 3 for each marker."""
    placed: Placed
    """At the angles before the last step, at most :data:`_CONVERGED_RAD` away once converged."""


def readings_of(positions: Positions, model: MarkerModel) -> Readings:
    """The markers of one instant that tell anything of the angles."""
    names = [name for name in model.names if name in positions.seen]
    covariances = np.array([positions.seen[name].covariance for name in names]).reshape(-1, 3, 3)
    return Readings(
        rows=np.array([model.index[name] for name in names], dtype=np.intp),
        points=np.array([positions.seen[name].position for name in names]).reshape(-1, 3),
        weights=np.asarray(np.linalg.inv(covariances + _FLOOR), dtype=np.float64),
        spreads=np.sqrt(covariances[:, 0, 0] + covariances[:, 1, 1] + covariances[:, 2, 2]),
    )


def fit(model: MarkerModel, readings: Readings, prior: Belief, start: Array, worth: float, steps: int) -> Fit:
    """Gauss-Newton from ``start``.

    Args:
        model: the arm's markers.
        readings: of one instant; may be empty.
        prior: what is known beside them; its information must be positive definite.
        start: radians.
        worth: of one instant's reading as a share of an independent one, ``1 / k`` above.
        steps: at most so many.
    """
    limits, q = model.chain.limits, start
    for _ in range(steps):
        placed = model.at(q)
        residuals = readings.points - placed.points[readings.rows]
        jacobians = placed.jacobians[readings.rows]
        weighted = (readings.weights @ residuals[:, :, None])[:, :, 0]
        squares = (weighted * residuals).sum(axis=1)
        shares = worth * np.minimum(1.0, _HUBER_SIGMAS / np.sqrt(np.maximum(squares, 1e-12)))
        scaled = (readings.weights * shares[:, None, None]) @ jacobians
        flat = jacobians.reshape(-1, len(q))
        information = prior.information + flat.T @ scaled.reshape(-1, len(q))
        gradient = prior.information @ (prior.mean - q) + scaled.reshape(-1, len(q)).T @ residuals.ravel()
        step = np.linalg.solve(information, gradient)
        longest = float(np.abs(step).max())
        if longest > _LONGEST_STEP_RAD:
            step *= _LONGEST_STEP_RAD / longest
        moved = _within(q + step, information, limits)
        last, q = moved - q, moved
        if np.abs(last).max() < _CONVERGED_RAD:
            break
    residuals = residuals - jacobians @ last
    misfit = float(((readings.weights @ residuals[:, :, None])[:, :, 0] * residuals).sum())
    return Fit(q, information, misfit, placed)


def _within(q: Array, information: Array, limits: Array) -> Array:
    """Conditions the angles on their limits: where one is at its end, the others follow by what ties them to it."""
    inside = np.clip(q, limits[:, 0], limits[:, 1])
    ended = inside != q
    if not ended.any():
        return q
    free = ~ended
    if free.any():
        tied = information[np.ix_(free, ended)] @ (inside - q)[ended]
        q = q.copy()
        q[free] -= np.linalg.solve(information[np.ix_(free, free)], tied)
        q[ended] = inside[ended]
        return np.clip(q, limits[:, 0], limits[:, 1])
    return inside
