"""Where a bundle adjustment begins: camera poses and joint angles from the rough places that each camera alone sees."""

from dataclasses import dataclass

import numpy as np

from armsight_operator.calibrate.arm import MarkedArm
from armsight_operator.calibrate.lens import Array
from armsight_operator.calibrate.rigid import CameraPose, aligned

STARTS = 24
"""Configurations from which a pose's angles are searched."""

_STEPS = 25
_ROUNDS = 4
_ROUGH_M = 0.5
"""How far off a place by a sphere's size may be before it counts less."""
_SAME_RAD = 0.05
_SAME_M = 0.02


@dataclass(frozen=True, slots=True)
class Rough:
    """What the cameras alone see: c cameras, k poses, m markers."""

    places: Array
    """c x k x m x 3, metres in each camera's frame."""
    weight: Array
    """c x k x m: 0 where a marker is not seen."""


def cameras_at(arm: MarkedArm, rough: Rough, q: Array) -> list[CameraPose]:
    """Poses of all cameras that bring what they see to where the markers are at these angles."""
    world, _ = arm.centres(q)
    return [_robustly_aligned(places, world, weight) for places, weight in zip(rough.places, rough.weight, strict=True)]


def angles_and_cameras(
    arm: MarkedArm, rough: Rough, cameras: list[CameraPose], held: frozenset[int], seed: int = 1
) -> tuple[Array, list[CameraPose], int]:
    """Angles that no one knows, from camera poses that are about right.

    By turns: angles that fit to where the cameras put the markers, cameras that fit to where these angles put them.

    Returns:
        k x joints; the cameras; and how many poses have a twin: other angles with every marker at the same place.
    """
    twins = 0
    q = np.zeros((rough.places.shape[1], arm.joints))
    for _ in range(_ROUNDS):
        world = np.stack([pose.to_world(places) for pose, places in zip(cameras, rough.places, strict=True)])
        weight = rough.weight[..., None]
        mean = (world * weight).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-9)
        q, twins = _angles(arm, mean, rough.weight.sum(axis=0), seed)
        for index, pose in enumerate(cameras_at(arm, rough, q)):
            if index not in held:
                cameras[index] = pose
    return q, cameras, twins


def _robustly_aligned(places: Array, world: Array, weight: Array) -> CameraPose:
    points, targets, weights = places[weight > 0], world[weight > 0], weight[weight > 0]
    pose = aligned(points, targets, weights)
    for _ in range(10):
        apart = np.linalg.norm(pose.to_world(points) - targets, axis=1)
        pose = aligned(points, targets, weights / (1 + (apart / _ROUGH_M) ** 2))
    return pose


def _angles(arm: MarkedArm, world: Array, weight: Array, seed: int) -> tuple[Array, int]:
    """Of each pose, from many configurations: Gauss and Newton's method with damping, all at once."""
    poses, joints = world.shape[0], arm.joints
    low, high = arm.arm.limits.T
    random = np.random.default_rng(seed)
    q = random.uniform(low, high, (poses, STARTS, joints)).reshape(-1, joints)
    target, shares = np.repeat(world, STARTS, axis=0), np.repeat(weight, STARTS, axis=0)
    for step in range(_STEPS):
        points, change = arm.centres(q)
        off = points - target
        share = shares / (1 + (np.linalg.norm(off, axis=2) / _ROUGH_M) ** 2) if step > 5 else shares
        matrix = np.einsum("bmia,bmic,bm->bac", change, change, share)
        matrix += np.eye(joints) * (1e-3 + 1e-2 * np.trace(matrix, axis1=1, axis2=2))[:, None, None]
        right = -np.einsum("bmia,bmi,bm->ba", change, off, share)
        q = np.clip(q + np.linalg.solve(matrix, right[..., None])[..., 0].clip(-0.5, 0.5), low, high)
    points, _ = arm.centres(q)
    apart = np.linalg.norm(points - target, axis=2)
    cost = (shares * np.log1p((apart / _ROUGH_M) ** 2)).sum(axis=1).reshape(poses, STARTS)
    best = cost.argmin(axis=1)
    every, places = q.reshape(poses, STARTS, joints), points.reshape(poses, STARTS, -1, 3)
    rows = np.arange(poses)
    chosen, chosen_points = every[rows, best], places[rows, best]
    differs = np.abs(np.angle(np.exp(1j * (every - chosen[:, None])))).max(axis=2) > _SAME_RAD
    coincides = np.linalg.norm(places - chosen_points[:, None], axis=3).max(axis=2) < _SAME_M
    return chosen, int((differs & coincides).any(axis=1).sum())
