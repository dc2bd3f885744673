r"""Angles and velocities as one normal distribution that moves on from instant to instant.

Constant velocity, but for what commands change of it:

.. math::
    v_{k+1} = v_k + (u_{k+1} - u_k) + w, \quad q_{k+1} = q_k + v_{k+1} \Delta t

with :math:`u` the speed of the setpoint. Setpoints are memory of what was asked, never a measurement of where the arm
is: only their changes enter, and the cameras correct what follows from them. The noise :math:`w` is white acceleration
of density :math:`s` (rad²/s³): covariance :math:`s \Delta t^3/3` of the angles, :math:`s \Delta t` of the velocities
and :math:`s \Delta t^2/2` between them.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from armsight_control.chain import Array


@dataclass(frozen=True)
class Moving:
    """Where every joint is and how fast it turns; radians and seconds."""

    q: Array
    v: Array
    covariance: Array
    """2n x 2n, of the angles and then the velocities."""

    @property
    def angles_covariance(self) -> Array:
        """Joints x joints."""
        return self.covariance[: len(self.q), : len(self.q)]

    @cached_property
    def angles_information(self) -> Array:
        """The inverse of :attr:`angles_covariance`."""
        return np.asarray(np.linalg.inv(self.angles_covariance), dtype=np.float64)


def at_rest(q: Array, sigma_rad: float, sigma_rad_s: float) -> Moving:
    """Every joint near ``q`` and at rest, each known that well."""
    sigmas = np.repeat([sigma_rad, sigma_rad_s], len(q))
    return Moving(q, np.zeros(len(q)), np.diag(sigmas**2))


def predicted(state: Moving, dt_s: float, change: Array, density: Array) -> Moving:
    """A time ``dt_s`` later.

    Args:
        state: now.
        dt_s: seconds.
        change: of every joint's velocity, as commanded, rad/s.
        density: of every joint's acceleration noise, rad²/s³.
    """
    n = len(state.q)
    v = state.v + change
    carry, noise = _model(n, dt_s)
    covariance = carry @ state.covariance @ carry.T + noise * np.concatenate([density, density])
    return Moving(state.q + v * dt_s, v, covariance)


@lru_cache(maxsize=64)
def _model(n: int, dt_s: float) -> tuple[Array, Array]:
    """Transition, and noise of density 1, over ``dt_s`` seconds: frames come at few different intervals."""
    each = np.eye(n)
    carry = np.array([[1.0, dt_s], [0.0, 1.0]])
    noise = np.array([[dt_s**3 / 3, dt_s**2 / 2], [dt_s**2 / 2, dt_s]])
    return np.asarray(np.kron(carry, each)), np.asarray(np.kron(noise, each))


def loosened(state: Moving, dt_s: float, acceleration: float) -> Moving:
    """As if every joint might have been accelerated that hard (rad/s²) for the last ``dt_s`` seconds."""
    n = len(state.q)
    each = np.arange(n)
    moved, gained = acceleration * dt_s**2 / 2, acceleration * dt_s
    covariance = state.covariance.copy()
    covariance[each, each] += moved**2
    covariance[each, n + each] += moved * gained
    covariance[n + each, each] += moved * gained
    covariance[n + each, n + each] += gained**2
    return Moving(state.q, state.v, covariance)


def updated(state: Moving, q: Array, angles_covariance: Array) -> Moving:
    """The same once the angles are known better; velocities follow by what ties them to the angles.

    Args:
        state: before, as it was the prior of the fit.
        q: the fit's angles.
        angles_covariance: of the fit, prior included.
    """
    n = len(state.q)
    gain = state.covariance[:, :n] @ state.angles_information
    covariance = state.covariance - gain @ (state.angles_covariance - angles_covariance) @ gain.T
    return Moving(q, state.v + (gain @ (q - state.q))[n:], (covariance + covariance.T) / 2)
