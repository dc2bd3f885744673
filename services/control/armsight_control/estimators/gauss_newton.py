r"""The angles that explain all markers and what was known before best, within the limits.

.. math::
    \min_q \; \tfrac{1}{k} \sum_i \rho\big(\lVert p_i(q) - z_i \rVert^2_{C_i + f^2 I}\big)
        + (q - \bar q)^T \Lambda (q - \bar q)

with Huber's :math:`\rho`: a marker whose covariance denies its error counts for less. :math:`\bar q, \Lambda` are mean
and information of the prior, :math:`f` the floor and :math:`k` the number of readings that are worth one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import mul

import numpy as np

from armsight_control.chain import Array, Rows, Triple
from armsight_control.estimators.definite import solved
from armsight_control.estimators.marker_model import MarkerModel, Placed
from armsight_control.positions import Positions
from armsight_control.spread import inverse

# Systematic errors that no covariance of a single frame knows: of the lens' and sphere's model, one camera pixel being
# 38 mm. It keeps a marker that claims micrometres from outweighing all others.
FLOOR_M = 1e-3
# Normalised errors of more than this are not of the stated distribution (0.1 % of three normal variables are beyond).
_HUBER_SIGMAS = 4.0
# No step is longer: from far away the linear model is wrong.
_LONGEST_STEP_RAD = 0.5
# What is left after a step of this length is its square: a millionth.
_CONVERGED_RAD = 1e-3


@dataclass(frozen=True, slots=True)
class Readings:
    """The markers that were seen at one instant, in plain floats."""

    rows: list[int]
    """Their indices in the model."""
    points: list[Triple]
    """(markers, 3), base frame, metres."""
    weights: list[Rows]
    """(markers, 3, 3): inverse covariances, floor included, 1/m²."""
    spreads: list[float]
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
    readings, floor = Readings([], [], [], []), FLOOR_M**2
    for row, name in enumerate(model.names):
        marker = positions.seen.get(name)
        if marker is None:
            continue
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = marker.covariance.tolist()
        x, y, z = marker.position.tolist()
        readings.rows.append(row)
        readings.points.append((x, y, z))
        readings.weights.append(inverse(((xx + floor, xy, xz), (xy, yy + floor, yz), (xz, yz, zz + floor))))
        readings.spreads.append(math.sqrt(xx + yy + zz))
    return readings


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
    chain, mean, known = model.chain, prior.mean.tolist(), prior.information.tolist()
    q = start.tolist()
    for _ in range(steps):
        placed = model.at(q)
        information, gradient = _normal_equations(readings, placed, known, mean, q, worth)
        step = solved(information, gradient)
        longest = max(map(abs, step))
        if longest > _LONGEST_STEP_RAD:
            step = [each * (_LONGEST_STEP_RAD / longest) for each in step]
        moved = [angle + each for angle, each in zip(q, step, strict=True)]
        if not all(lower <= angle <= upper for angle, (lower, upper) in zip(moved, chain.bounds, strict=True)):
            moved = _within(np.array(moved), np.array(information), chain.limits).tolist()
        last, q = [after - before for after, before in zip(moved, q, strict=True)], moved
        if max(map(abs, last)) < _CONVERGED_RAD:
            break
    return Fit(np.array(q), np.array(information), _misfit(readings, placed, last), placed)


def _normal_equations(
    readings: Readings, placed: Placed, known: Rows, mean: Sequence[float], q: Sequence[float], worth: float
) -> tuple[list[list[float]], list[float]]:
    r""":math:`\Lambda + \sum_i w_i J_i^T W_i J_i` and :math:`\Lambda (\bar q - q) + \sum_i w_i J_i^T W_i r_i`.

    W is the inverse covariance of a reading, r what it is off by, w its share by Huber's rule.
    """
    off = [there - here for there, here in zip(mean, q, strict=True)]
    information = [list(row) for row in known]
    gradient = [sum(map(mul, row, off)) for row in known]
    for row, point, weight in zip(readings.rows, readings.points, readings.weights, strict=True):
        (x, y, z), columns = placed.found[row]
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = weight
        r, s, t = point[0] - x, point[1] - y, point[2] - z
        share = worth * min(1.0, _HUBER_SIGMAS / math.sqrt(max(_chi2(weight, r, s, t), 1e-12)))
        for i, (u, v, w) in enumerate(columns):
            a = share * (xx * u + xy * v + xz * w)
            b = share * (xy * u + yy * v + yz * w)
            c = share * (xz * u + yz * v + zz * w)
            gradient[i] += a * r + b * s + c * t
            line = information[i]
            for j in range(i + 1):
                k, l, m = columns[j]  # noqa: E741
                line[j] += a * k + b * l + c * m
    for i, line in enumerate(information):
        for j in range(i):
            information[j][i] = line[j]
    return information, gradient


def _misfit(readings: Readings, placed: Placed, step: Sequence[float]) -> float:
    """Chi squared of the markers once a step was taken, by the Jacobians before it."""
    total = 0.0
    for row, point, weight in zip(readings.rows, readings.points, readings.weights, strict=True):
        (x, y, z), columns = placed.found[row]
        r, s, t = point[0] - x, point[1] - y, point[2] - z
        for (u, v, w), each in zip(columns, step, strict=True):
            r, s, t = r - u * each, s - v * each, t - w * each
        total += _chi2(weight, r, s, t)
    return total


def _chi2(weight: Rows, r: float, s: float, t: float) -> float:
    """What a reading is off by, as its inverse covariance counts it, of which the lower triangle is not read."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = weight
    return r * (xx * r + 2.0 * (xy * s + xz * t)) + s * (yy * s + 2.0 * yz * t) + zz * t * t


def _within(q: Array, information: Array, limits: Array) -> Array:
    """Conditions the angles on their limits: where one is at its end, the others follow by what ties them to it."""
    inside = np.clip(q, limits[:, 0], limits[:, 1])
    ended = inside != q
    free = ~ended
    if free.any():
        tied = information[np.ix_(free, ended)] @ (inside - q)[ended]
        q = q.copy()
        q[free] -= np.linalg.solve(information[np.ix_(free, free)], tied)
        q[ended] = inside[ended]
        return np.clip(q, limits[:, 0], limits[:, 1])
    return inside
