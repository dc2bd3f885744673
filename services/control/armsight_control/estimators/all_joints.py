"""All joints at once from all markers: prediction, Gauss-Newton on every marker, and candidates when that is no good.

Starts from the setpoint in force, which settles the twin; everything else comes from the cameras. A marker that is lost
or vague lowers the weight of its own reading, nothing else: what this instant's markers do not tell is predicted, with
an uncertainty that grows.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from armsight.times import NS_PER_S
from armsight_control.chain import Array
from armsight_control.description import Arm
from armsight_control.estimators.candidates import Candidates
from armsight_control.estimators.estimate import Estimate
from armsight_control.estimators.gauss_newton import Belief, Fit, Readings, fit, readings_of
from armsight_control.estimators.kalman import Moving, at_rest, loosened, predicted, updated
from armsight_control.estimators.marker_model import MarkerModel, Placed
from armsight_control.positions import Positions
from armsight_control.spread import largest_variance

NAME = "all"

# Readings that are worth an independent one: errors of red and blue are alike by 0.3 to 0.4 from frame to frame (which
# makes 2), yellow's by 0.7 (6), but the covariances are twice what the errors are.
_READINGS_WORTH_ONE = 2.0
# Of acceleration that no command explains, rad²/s³: 0.03 rad/s after a second. From 1e-5 to 1e-2 the RMS over the test
# of all joints rises from 1.8 to 3.4 mrad; 1e-3 leaves a blocked arm a tip that is known to 0.5 m for 2.7 s, no longer.
_DENSITY = 1e-3
# Of a commanded change of speed, the share that may come later, or not at all.
_LAG = 0.5

# At the start: an arm that moves is behind its setpoint by a tenth of a second of the speed it may have.
_START_RAD = 0.2
_START_RAD_S = 1.5
# Beyond this nothing is known of how the arm moved meanwhile.
_LONGEST_GAP_S = 0.5
# A setpoint is commanded no faster than its joint's speed; what moves farther was set (a reset).
_SET_RAD = 1e-3
_FRAME_S = 1 / 30

_STEPS, _STEPS_FROM_AFAR = 4, 15
# Chi squared for each group of three errors that is still believed: beyond it are 0.7 % of one group, 1e-6 of four.
_GATE = 12.0
# A blocked or unexpectedly driven arm changes its speed that hard (1000 Nm on 4 kg at 3 m: 28 rad/s²).
_MANOEUVRE_RAD_S2 = 20.0
# A candidate must explain the markers so much better for the prediction to be left, and is as good as another within
# that much: chi squared both.
_FAR_BETTER, _AS_GOOD = 50.0, 9.0
# What is nearer is no other branch but a marker that is wrong, unless several deny the prediction and all agree.
_ELSEWHERE_RAD = 0.3
# What candidates start with: nothing known, but no direction left open.
_UNKNOWN_RAD = 10.0

# The report's definition of observable: 2 mm on every marker move the joint by less than 10 mrad. A marker vaguer than
# 20 mm counts by its own covariance.
_NOISE_M, _VAGUE_M, _OBSERVABLE_RAD = 0.002, 0.020, 0.010
_AS_REPORTED = (np.eye(3) / _NOISE_M**2).tolist()


@dataclass(frozen=True, slots=True)
class Track:
    """What is carried from one instant to the next."""

    moving: Moving
    capture_ns: int
    setpoint: Array
    speed: Array
    """Of the setpoint, rad/s."""
    dt_s: float
    """From the instant before to this one; 0 at the first."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """One instant's answer."""

    track: Track
    estimate: Estimate
    sigma: Array
    """One standard deviation of every joint, rad."""
    tip_sigma: float
    """Standard deviation of the tip in its worst direction, metres."""
    restarted: bool
    """The prediction was on a wrong branch and was left."""


class AllJoints:
    """The estimator of one arm; holds nothing that changes."""

    def __init__(self, arm: Arm) -> None:
        """Derives the model and the candidates from the description."""
        self._model = MarkerModel(arm)
        self._candidates = Candidates(arm)
        self._chain = arm.chain

    def step(self, track: Track | None, positions: Positions, setpoint: Array) -> Outcome:
        """The angles at one instant.

        Args:
            track: what this function returned last; none at the start.
            positions: of a later instant than the last ones.
            setpoint: in force, radians. Settles the start and the twin; later only its changes are used.
        """
        readings = readings_of(positions, self._model)
        track, prior = self._carried(track, positions.capture_ns, setpoint)
        best, restarted = self._fit(readings, prior), False
        gate = _GATE * (1 + len(readings.rows))
        if _surprise(best, prior) > gate:
            loose = loosened(prior, track.dt_s or _FRAME_S, _MANOEUVRE_RAD_S2)
            again = self._fit(readings, loose)
            if _surprise(again, loose) <= gate:
                prior, best = loose, again
            else:
                found = self._found(positions, readings, prior, setpoint)
                if self._is_wrong(best, found, readings):
                    restarted = True
                    prior = at_rest(found.q, _START_RAD, _START_RAD_S)
                    best = self._fit(readings, prior)
        moving = updated(prior, best.q, np.asarray(np.linalg.inv(best.information), dtype=np.float64))
        _, columns = best.placed.found[-1]
        by_tip = np.array(columns)
        spread = largest_variance(by_tip.T @ moving.angles_covariance @ by_tip)
        sigma = np.sqrt(moving.angles_covariance.diagonal())
        estimate = Estimate(
            estimator=NAME,
            angles=moving.q,
            told=partial(_told, readings, best.placed),
            misfit=(best.misfit / max(1, 3 * len(readings.rows))) ** 0.5,
            sigma=sigma,
            velocity=moving.v,
        )
        return Outcome(replace(track, moving=moving), estimate, sigma, max(0.0, spread) ** 0.5, restarted)

    def _carried(self, track: Track | None, capture_ns: int, setpoint: Array) -> tuple[Track, Moving]:
        """The track at this instant and what it predicts; anew from the setpoint where nothing can be carried on."""
        if track is not None:
            dt_s = (capture_ns - track.capture_ns) / NS_PER_S
            # the setpoint in force now answered the instant before, so that it moved for the interval before that
            over_s = track.dt_s or dt_s
            moved = setpoint - track.setpoint
            farthest = self._chain.max_speed * max(over_s, dt_s) + _SET_RAD
            if 0 < dt_s <= _LONGEST_GAP_S and (np.abs(moved) <= farthest).all():
                speed = moved / over_s
                change = speed - track.speed
                density = _DENSITY + (_LAG * change) ** 2 / dt_s
                moving = predicted(track.moving, dt_s, change, density)
                return Track(moving, capture_ns, setpoint, speed, dt_s), moving
        moving = at_rest(setpoint, _START_RAD, _START_RAD_S)
        return Track(moving, capture_ns, setpoint, np.zeros(len(setpoint)), 0.0), moving

    def _fit(self, readings: Readings, prior: Moving) -> Fit:
        belief = Belief(prior.q, prior.angles_information)
        return fit(self._model, readings, belief, self._chain.clip(prior.q), 1 / _READINGS_WORTH_ONE, _STEPS)

    def _is_wrong(self, best: Fit, found: Fit, readings: Readings) -> bool:
        """Whether what was predicted has to be left for what the markers alone say."""
        off = np.array(readings.points).reshape(-1, 3) - best.placed.points[readings.rows]
        weights = np.array(readings.weights).reshape(-1, 3, 3)
        denied = np.einsum("mi,mij,mj->m", off, weights, off) > _GATE
        agree = denied.sum() > 1 and found.misfit <= _GATE * len(readings.rows)
        elsewhere = np.abs(found.q - best.q).max() > _ELSEWHERE_RAD
        return bool((agree or elsewhere) and found.misfit + _FAR_BETTER < best.misfit)

    def _found(self, positions: Positions, readings: Readings, prior: Moving, setpoint: Array) -> Fit:
        """The fit from the candidate that explains the markers best; among equals the nearest to the setpoint."""
        starts = [self._chain.clip(prior.q), setpoint, *self._candidates.of(positions)]
        unknown = np.eye(len(setpoint)) / _UNKNOWN_RAD**2
        fits = [fit(self._model, readings, Belief(q, unknown), q, 1.0, _STEPS_FROM_AFAR) for q in starts]
        least = min(found.misfit for found in fits)
        equals = [found for found in fits if found.misfit <= least + _AS_GOOD]
        return min(equals, key=lambda found: float(np.abs(found.q - setpoint).sum()))


def _surprise(best: Fit, prior: Moving) -> float:
    """Chi squared of markers and prediction together."""
    off = best.q - prior.q
    return best.misfit + float(off @ prior.angles_information @ off)


def _told(readings: Readings, placed: Placed) -> tuple[bool, ...]:
    """Which joints the markers of this instant tell."""
    joints = len(placed.found[-1][1])
    information = np.zeros((joints, joints))
    for row, weight, spread in zip(readings.rows, readings.weights, readings.spreads, strict=True):
        columns = np.array(placed.found[row][1])
        information += columns @ np.array(weight if spread > _VAGUE_M else _AS_REPORTED) @ columns.T
    # so little that a joint which nothing tells comes out as not told instead of as a singular matrix
    variances = np.linalg.inv(information + np.eye(joints) * 1e-6).diagonal()
    return tuple((variances < _OBSERVABLE_RAD**2).tolist())
