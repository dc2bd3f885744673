r"""Keeps the links away from a point: capsules, clearances, and the joint speeds that keep a clearance.

A link is a segment with a radius. With h its clearance beyond what is asked for, joint speeds are allowed where
:math:`\nabla h \cdot \dot q + \partial h / \partial t \ge -\gamma h` (a control barrier function: Ames et al., Control
Barrier Functions: Theory and Applications, 2019): the nearer, the slower, and away from it where it is too near.
"""

from dataclasses import dataclass

import numpy as np

from armsight.v1.description_pb2 import ArmDescription
from armsight_control.chain import Array, Chain, Point
from armsight_control.kinematics import jacobian, position
from armsight_control.tracking import Moving

# 1/s: at the speed limit, 1.5 rad/s, this brakes by 3 rad/s², half of what is allowed.
_GAMMA = 2.0
_ROUNDS = 30
_ON_AXIS_M = 1e-3
# What the projection may leave.
_LEFT_M_S = 1e-3


@dataclass(frozen=True, slots=True)
class Capsule:
    """A moving link: all points within ``radius_m`` of a segment in its joint's frame."""

    joint: int
    start: Array
    end: Array
    radius_m: float


@dataclass(frozen=True, slots=True)
class Clearance:
    """Of one link to a point."""

    distance_m: float
    """From the link's surface."""
    gradient: Array
    """Of that distance by the joints, metres per radian."""
    away: Array
    """Unit vector from the point to the link: minus the distance's gradient by the point."""


@dataclass(frozen=True, slots=True)
class Allowed:
    """Joint speeds that keep the clearances."""

    velocity: Array
    slowed: bool
    """Whether they differ from those asked for."""
    found: bool
    """Whether they keep all of them."""


def capsules_of(message: ArmDescription, chain: Chain) -> tuple[Capsule, ...]:
    """The links that move in space: not those of the base, nor what joint 1 merely turns about their own axis."""
    found = []
    for link in message.links:
        joint = chain.names.index(link.joint) if link.joint in chain.names else -1
        start = np.array([link.start.x, link.start.y, link.start.z])
        end = np.array([link.end.x, link.end.y, link.end.z])
        swings = max(float(np.linalg.norm(np.cross(chain.axes[0], at))) for at in (start, end)) > _ON_AXIS_M
        if joint > 0 or (joint == 0 and swings):
            found.append(Capsule(joint, start, end, link.radius_m))
    return tuple(found)


def clearances(chain: Chain, q: Array, capsules: tuple[Capsule, ...], point: Array) -> list[Clearance]:
    """How far every link is from a point of the base frame."""
    found = []
    for capsule in capsules:
        start = position(chain, q, Point(capsule.joint, capsule.start))
        along = position(chain, q, Point(capsule.joint, capsule.end)) - start
        share = float(np.clip((point - start) @ along / max(float(along @ along), 1e-12), 0.0, 1.0))
        nearest = Point(capsule.joint, capsule.start + share * (capsule.end - capsule.start))
        between = start + share * along - point
        distance = float(np.linalg.norm(between))
        # on the very axis every direction leads away: any will do
        away = between / distance if distance > 1e-9 else np.array([0.0, 0.0, 1.0])
        found.append(Clearance(distance - capsule.radius_m, away @ jacobian(chain, q, nearest), away))
    return found


def allowed(
    chain: Chain, q: Array, capsules: tuple[Capsule, ...], point: Moving, keep_m: float, wanted: Array, most: Array
) -> Allowed:
    """The joint speeds nearest to those wanted that keep every link ``keep_m`` away from a moving point.

    Args:
        chain: the arm.
        q: all joints, radians.
        capsules: its links.
        point: base frame.
        keep_m: from the links' surfaces.
        wanted: rad/s.
        most: rad/s, of each joint either way.
    """
    rows, least = [], []
    for clearance in clearances(chain, q, capsules, point.position):
        rows.append(clearance.gradient)
        approach = -float(clearance.away @ point.velocity)
        least.append(-_GAMMA * (clearance.distance_m - keep_m) - approach)
    if not rows:
        return Allowed(wanted, slowed=False, found=True)
    gradients, bounds = np.array(rows), np.array(least)
    if (gradients @ wanted >= bounds).all():
        return Allowed(wanted, slowed=False, found=True)
    # Dykstra's alternating projections on the half-spaces and the box of speeds: the nearest point of all of them
    velocity = wanted.copy()
    increments = np.zeros((len(bounds) + 1, len(wanted)))
    for _ in range(_ROUNDS):
        for i, (row, bound) in enumerate(zip(gradients, bounds, strict=True)):
            moved = velocity + increments[i]
            short = bound - float(row @ moved)
            square = float(row @ row)
            projected = moved + row * (short / square) if short > 0 and square > 1e-12 else moved
            increments[i], velocity = moved - projected, projected
        moved = velocity + increments[-1]
        velocity = np.clip(moved, -most, most)
        increments[-1] = moved - velocity
    return Allowed(velocity, slowed=True, found=bool((gradients @ velocity >= bounds - _LEFT_M_S).all()))
