r"""Marker positions from the cameras: checked, in the base frame, and turned into the directions of links 3 and 4.

The markers' centres are not at the joints. Those on the last link lie on its axis, ``s`` metres from joint 4, so

.. math:: r_4 \parallel p_{red} - p_{blue}, \quad joint_4 = p_i - s_i r_4, \quad r_3 \parallel joint_4 - shoulder.

Both links' lengths are known: the directions are the two unit vectors that explain all markers of the last link best,
each weighted by its covariance. A marker that only one camera sees, vague along that camera's ray, then helps where it
is good and does no harm where it is not.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from armsight.times import NS_PER_S
from armsight.v1.joints_pb2 import (
    MARKER_STATUS_LOST,
    MARKER_STATUS_ONE_VIEW,
    MARKER_STATUS_PARTLY_OCCLUDED,
    MARKER_STATUS_TRACKED,
    JointPositions,
    MarkerPosition,
)
from armsight_control.chain import Array, Chain, Rows, Triple
from armsight_control.description import Arm
from armsight_control.errors import PositionsError, UnsupportedArmError
from armsight_control.kinematics import frames, position
from armsight_control.spread import is_positive

# Farther than any scene: what lies beyond is a broken message.
_MAX_POSITION_M = 1e4
# Lower than any camera's: a covariance of zero must not outweigh all else.
_FLOOR_M = 1e-3
# Distances may be off by this much beyond their own uncertainty, of an arm of 10 m: centroids of half-hidden spheres
# are off by up to 0.11 m each. It is a guard against wild values, not a measure of quality.
_DISTANCE_SLACK_M = 0.25
_DISTANCE_SIGMAS = 4.0
# The tip must be known this well (one standard deviation) for the arm to be moved by sight.
TIP_SIGMA_MAX_M = 0.5
_FIT_STEPS = 3
# Two markers that are nearer to one another than this show no direction.
_LEAST_APART_M = 0.1

_USABLE = (MARKER_STATUS_TRACKED, MARKER_STATUS_PARTLY_OCCLUDED, MARKER_STATUS_ONE_VIEW)


@dataclass(frozen=True, slots=True)
class SeenMarker:
    """One marker that at least one camera saw at this instant; base frame."""

    position: Array
    covariance: Array
    one_view: bool


@dataclass(frozen=True, slots=True)
class Positions:
    """Markers of one instant that may be used as measurements."""

    capture_ns: int
    seen: Mapping[str, SeenMarker]


@dataclass(frozen=True, slots=True)
class Directions:
    """Where links 3 and 4 point, and what follows from it; base frame, metres."""

    r3: Array
    r4: Array
    joint4: Array
    tip: Array
    tip_sigma: float
    """Standard deviation of the tip in its worst direction."""


@dataclass(frozen=True, slots=True)
class LastLinks:
    """How the markers of the last link lie on its axis: derived once from the description."""

    shoulder: Array
    """Where link 3 begins: fixed in the base frame."""
    length3: float
    length4: float
    along: Mapping[str, float]
    """Marker name → metres from joint 4 along link 4."""


@dataclass(frozen=True)
class TipLine:
    """The markers on one line with the tip, on its link: what shows where the tip is, whatever the angles."""

    along: Mapping[str, float]
    """Marker name → metres along the line."""
    tip: float
    """Of the tip, along the same line from the same point: of the report's arm the length of link 4."""

    @cached_property
    def ends(self) -> tuple[str, str]:
        """The markers nearest to the tip and farthest from it."""
        names = sorted(self.along, key=lambda name: abs(self.along[name] - self.tip))
        return names[0], names[-1]


def capture_of(message: JointPositions) -> int:
    """The instant of the positions, Unix nanoseconds.

    Raises:
        PositionsError: not a time after 1970, or nanoseconds out of range.
    """
    stamp = message.capture_time
    if stamp.seconds < 0 or stamp.seconds > 1 << 33 or not 0 <= stamp.nanos < NS_PER_S:
        raise PositionsError("time", f"capture time {stamp.seconds} s {stamp.nanos} ns is not Unix time")
    return stamp.seconds * NS_PER_S + stamp.nanos


def positions_of(message: JointPositions, arm: Arm) -> Positions:
    """Checks the message and takes its markers into the base frame; markers the arm does not have are left out.

    Raises:
        PositionsError: a value that no measurement can have.
    """
    used: dict[str, MarkerPosition] = {}
    for marker in message.markers:
        if marker.name not in arm.markers or marker.status == MARKER_STATUS_LOST:
            continue
        if marker.status not in _USABLE:
            raise PositionsError("status", f"marker {marker.name} has no status: expected tracked, occluded or lost")
        if marker.name in used:
            raise PositionsError("twice", f"marker {marker.name} is there twice")
        used[marker.name] = marker
    places = arm.world_to_base(np.array(_finite_positions(used)).reshape(-1, 3))
    covariances = arm.R_world_base.T @ np.array(_covariances(used)).reshape(-1, 3, 3) @ arm.R_world_base
    seen = {
        name: SeenMarker(place, covariance, marker.status == MARKER_STATUS_ONE_VIEW)
        for (name, marker), place, covariance in zip(used.items(), places, covariances, strict=True)
    }
    return Positions(capture_of(message), seen)


def last_links_of(arm: Arm) -> LastLinks:
    """Finds the markers on the last link's axis and the fixed end of the link before it.

    Raises:
        UnsupportedArmError: the description has no two markers on that axis, or the shoulder moves.
    """
    chain, last = arm.chain, arm.chain.count - 1
    length4 = float(np.linalg.norm(chain.tip.position))
    if last < 1 or chain.tip.joint != last or length4 <= 0:
        raise UnsupportedArmError("the tip is not on the last joint's link")
    axis = chain.tip.position / length4
    along = {
        name: float(point.position @ axis)
        for name, point in arm.markers.items()
        if point.joint == last and np.linalg.norm(point.position - (point.position @ axis) * axis) < _FLOOR_M
    }
    if not _apart(along):
        raise UnsupportedArmError(f"two markers on the last link's axis are needed, the description has {list(along)}")
    shoulder = _fixed_origins(chain).get(last - 1)
    if shoulder is None:
        raise UnsupportedArmError("the joint before the last one moves in space: r3 can't be told from its end")
    return LastLinks(shoulder, float(np.linalg.norm(chain.origins[last])), length4, along)


def tip_line_of(arm: Arm) -> TipLine | None:
    """Finds two markers or more on one line with the tip; nothing where there are none.

    The line through the joint is preferred: distances are from the joint then, as :class:`LastLinks` has them.
    """
    tip = arm.chain.tip
    here = {name: point.position for name, point in arm.markers.items() if point.joint == tip.joint}
    length = float(np.linalg.norm(tip.position))
    if length > 0:
        axis = tip.position / length
        along = {
            name: float(at @ axis) for name, at in here.items() if np.linalg.norm(at - (at @ axis) * axis) < _FLOOR_M
        }
        if _apart(along):
            return TipLine(along, length)
    for first, second in combinations(here.values(), 2):
        apart = float(np.linalg.norm(second - first))
        if apart < _FLOOR_M:
            continue
        axis = (second - first) / apart

        def off(at: Array, start: Array = first, axis: Array = axis) -> float:
            return float(np.linalg.norm(at - start - ((at - start) @ axis) * axis))

        along = {name: float(at @ axis) for name, at in here.items() if off(at) < _FLOOR_M}
        if off(tip.position) < _FLOOR_M and _apart(along):
            return TipLine(along, float(tip.position @ axis))
    return None


def shoulder_of(chain: Chain) -> Array:
    """The last joint's place, from the base on, that stays where it is whatever the angles; base frame, metres."""
    fixed = _fixed_origins(chain)
    return fixed[max(fixed)]


def _apart(along: Mapping[str, float]) -> bool:
    return len(along) > 1 and max(along.values()) - min(along.values()) >= _LEAST_APART_M


def directions_of(positions: Positions, links: LastLinks) -> Directions:
    """The unit vectors along links 3 and 4 that explain the markers of the last link best.

    Raises:
        PositionsError: a needed marker is lost, or what is left is too vague.
    """
    lost = [name for name in links.along if name not in positions.seen]
    if lost:
        raise PositionsError("lost", f"{' and '.join(lost)} can't be seen by any camera")
    names = sorted(links.along, key=lambda name: links.along[name])
    points = np.array([positions.seen[name].position for name in names])
    along = np.array([links.along[name] for name in names])
    floor = np.eye(3) * _FLOOR_M**2
    whiten = [np.linalg.inv(np.linalg.cholesky(positions.seen[name].covariance + floor)) for name in names]

    r4 = _unit(points[-1] - points[0])
    r3 = _unit(points[0] - along[0] * r4 - links.shoulder)
    design = np.empty((3 * len(names), 4))
    for _ in range(_FIT_STEPS):
        tangent3, tangent4 = _tangents(r3), _tangents(r4)
        residual = np.empty(3 * len(names))
        for i, (point, s, w) in enumerate(zip(points, along, whiten, strict=True)):
            rows = slice(3 * i, 3 * i + 3)
            residual[rows] = w @ (point - links.shoulder - links.length3 * r3 - s * r4)
            design[rows, :2] = w @ tangent3 * links.length3
            design[rows, 2:] = w @ tangent4 * s
        information = design.T @ design
        step = np.linalg.solve(information, design.T @ residual)
        r3, r4 = _unit(r3 + tangent3 @ step[:2]), _unit(r4 + tangent4 @ step[2:])
    tip_by_step = np.hstack([tangent3 * links.length3, tangent4 * links.length4])
    tip_covariance = tip_by_step @ np.linalg.solve(information, tip_by_step.T)
    tip_sigma = float(np.sqrt(np.linalg.eigvalsh(tip_covariance)[-1]))
    if tip_sigma > TIP_SIGMA_MAX_M:
        raise PositionsError("vague", f"the tip is known to ±{tip_sigma:.2f} m only: another camera must see the arm")
    joint4 = links.shoulder + links.length3 * r3
    return Directions(r3, r4, joint4, joint4 + links.length4 * r4, tip_sigma)


class DistanceBounds:
    """The least and greatest distances that the arm allows between its markers, and to its points that never move."""

    def __init__(self, arm: Arm) -> None:
        """Samples the arm's configurations, their corners included."""
        self._slack_m = _DISTANCE_SLACK_M * arm.chain.scale
        rng = np.random.default_rng(0)
        lower, upper = arm.chain.limits.T
        middle = np.clip(0.0, lower, upper)
        choices = np.stack([lower, middle, upper, *(rng.uniform(lower, upper) for _ in range(3))])
        picked = rng.integers(len(choices), size=(4096, arm.chain.count))
        q = np.take_along_axis(choices, picked, axis=0)
        places = {name: position(arm.chain, q, point) for name, point in arm.markers.items()}
        fixed = {f"joint {i + 1}": place for i, place in _fixed_origins(arm.chain).items()}
        others: dict[str, Array] = {**places, **fixed}
        self._names = list(others)
        self._rows = {name: i for i, name in enumerate(others)}
        self._places, self._covariances = np.full((len(others), 3), np.nan), np.zeros((len(others), 3, 3))
        for name, place in fixed.items():
            self._places[self._rows[name]] = place
        pairs = [(name, other) for name in places for other in (*(o for o in places if o > name), *fixed)]
        distances = [np.linalg.norm(places[name] - others[other], axis=-1) for name, other in pairs]
        self._least = np.array([each.min() for each in distances])
        self._greatest = np.array([each.max() for each in distances])
        self._pairs = np.array([[self._rows[name] for name in pair] for pair in pairs], dtype=np.intp).reshape(-1, 2).T
        self._fixed: dict[str, Triple] = {name: tuple(place.tolist()) for name, place in fixed.items()}
        least, greatest = self._least - self._slack_m, self._greatest + self._slack_m
        self._surely = [(*pair, *far) for pair, *far in zip(pairs, least.tolist(), greatest.tolist(), strict=True)]

    def check(self, positions: Positions) -> None:
        """Compares the markers of one instant with what the arm allows.

        Raises:
            PositionsError: two markers are nearer or farther than they can be, given their covariances.
        """
        if self._are_sure(positions):
            return
        places, covariances = self._places.copy(), self._covariances.copy()
        for name, marker in positions.seen.items():
            places[self._rows[name]], covariances[self._rows[name]] = marker.position, marker.covariance
        first, second = self._pairs
        between = places[first] - places[second]
        distances = np.sqrt((between * between).sum(axis=1))
        spreads = ((covariances[first] + covariances[second]) @ between[:, :, None])[:, :, 0]
        sigmas = np.sqrt(np.maximum(0.0, (spreads * between).sum(axis=1))) / np.maximum(distances, 1e-9)
        slack = self._slack_m + _DISTANCE_SIGMAS * sigmas
        # a marker that is not seen is nowhere, and no comparison with nowhere is true
        wrong = (distances < self._least - slack) | (distances > self._greatest + slack)
        if wrong.any():
            i = int(wrong.argmax())
            name, other = self._names[first[i]], self._names[second[i]]
            text = f"{name} is {distances[i]:.2f} m from {other}"
            allowed = f"this arm allows {self._least[i]:.2f} to {self._greatest[i]:.2f} m"
            raise PositionsError("implausible", f"{text}; {allowed}")

    def _are_sure(self, positions: Positions) -> bool:
        """Whether all distances are possible even if nothing were uncertain: what covariances allow is more."""
        places = {name: marker.position.tolist() for name, marker in positions.seen.items()} | self._fixed
        for name, other, least, greatest in self._surely:
            here, there = places.get(name), places.get(other)
            if here is not None and there is not None and not least <= math.dist(here, there) <= greatest:
                return False
        return True


def _fixed_origins(chain: Chain) -> dict[int, Array]:
    """Origins of the joints that stay where they are whatever the angles."""
    rng = np.random.default_rng(0)
    _, origins = frames(chain, rng.uniform(chain.limits[:, 0], chain.limits[:, 1], size=(8, chain.count)))
    moved = (origins.max(axis=0) - origins.min(axis=0)).max(axis=-1)
    return {i: origins[0, i + 1] for i in range(chain.count) if moved[i + 1] < _FLOOR_M * _FLOOR_M}


def _finite_positions(markers: Mapping[str, MarkerPosition]) -> list[Triple]:
    places = []
    for name, marker in markers.items():
        at = marker.position
        x, y, z = place = at.x, at.y, at.z
        # no comparison with what is not a number is true
        finite = abs(x) < _MAX_POSITION_M and abs(y) < _MAX_POSITION_M and abs(z) < _MAX_POSITION_M
        if not finite or not marker.HasField("position"):
            raise PositionsError("position", f"marker {name} has no finite position within {_MAX_POSITION_M:g} m")
        places.append(place)
    return places


def _covariances(markers: Mapping[str, MarkerPosition]) -> list[Rows]:
    given = {name: marker.covariance[:] for name, marker in markers.items()}
    for name, values in given.items():
        if len(values) != 9:
            raise PositionsError("covariance", f"marker {name} has no finite 3x3 covariance")
    for name, values in given.items():
        if not all(abs(value) < _MAX_POSITION_M**2 for value in values):
            raise PositionsError("covariance", f"marker {name} has no finite 3x3 covariance")
    checked: list[Rows] = []
    for name, (xx, xy, xz, yx, yy, yz, zx, zy, zz) in given.items():
        # rounding may leave it a little below zero: the fit must be able to factorise it
        little = 1e-6 * max(map(abs, given[name]))
        even = max(abs(xy - yx), abs(xz - zx), abs(yz - zy)) <= little
        xy, xz, yz = (xy + yx) / 2, (xz + zx) / 2, (yz + zy) / 2
        lifted = (xx + little, xy, xz), (xy, yy + little, yz), (xz, yz, zz + little)
        if not even or not is_positive(lifted):
            raise PositionsError("covariance", f"marker {name} has a covariance that is not symmetric and positive")
        checked.append(lifted)
    return checked


def _unit(vector: Array) -> Array:
    length = float(np.sqrt(vector @ vector))
    if length < 1e-9:
        raise PositionsError("implausible", "two markers are in one place")
    return np.asarray(vector / length)


def _tangents(unit: Array) -> Array:
    """Two unit vectors across a third, as columns (Duff et al., Building an Orthonormal Basis, Revisited, 2017)."""
    x, y, z = unit.tolist()
    sign = math.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.array([[1.0 + sign * x * x * a, b], [sign * b, sign + y * y * a], [-sign * x, -y]])
