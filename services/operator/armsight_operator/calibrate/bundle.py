r"""Bundle adjustment: camera poses, and joint angles where they are not known, from markers' centres in pictures.

Minimises :math:`\sum \rho(w\,|\pi_c(R_c^T(p_m(q_k) - t_c)) - u_{ckm}|)` by Levenberg and Marquardt's method. Each
pose's angles meet only their own pictures, so that they are eliminated pose by pose (Schur's complement): what is left
are six numbers a camera: a turn in its own frame (rad) and its position in the world (m).
"""

from dataclasses import dataclass, replace

import numpy as np

from armsight_operator.calibrate.arm import MarkedArm
from armsight_operator.calibrate.lens import Array, Lens, project
from armsight_operator.calibrate.rigid import CameraPose, cross_matrix, turn

_STEPS = 100
_SMALL = 1e-10
"""Share of the cost below which a step is the last."""
_ROBUST = 2.0
"""Standard deviations beyond which a residual counts less (Cauchy's function)."""
_VAGUE_RAD = 10.0
"""What is known of an unknown angle beforehand: nothing, but that it is one, so that no block is singular."""
_SIGMA_PX = 0.1
"""Of a centre that is wholly visible; only a unit, what it really is comes out."""

Integers = np.ndarray[tuple[int], np.dtype[np.intp]]


@dataclass(frozen=True, slots=True)
class Problem:
    """Everything that was measured: n centres."""

    arm: MarkedArm
    poses: int
    """k, seen or not."""
    lenses: tuple[Lens, ...]
    """Of the cameras in their order."""
    camera: Integers
    """n: index of the camera."""
    pose: Integers
    """n: index of the arm's pose."""
    marker: Integers
    """n: index of the marker."""
    pixels: Array
    """n x 2."""
    weight: Array
    """n: 1 for a marker that is wholly visible, less for others, 0 for what is left out."""
    held: frozenset[int] = frozenset()
    """Cameras whose pose is known."""
    angles_known: bool = False

    @property
    def free(self) -> tuple[int, ...]:
        """Cameras whose pose is wanted."""
        return tuple(index for index in range(len(self.lenses)) if index not in self.held)


@dataclass(frozen=True, slots=True)
class State:
    """An answer."""

    cameras: tuple[CameraPose, ...]
    angles: Array
    """k x joints, radians."""


@dataclass(frozen=True, slots=True)
class Linear:
    """Residuals of a state, in pixels, and their derivatives."""

    residuals: Array
    """n x 2: expected less measured."""
    by_camera: Array
    """n x 2 x 6: by the measuring camera's turn and position."""
    by_angles: Array
    """n x 2 x joints: by the angles of the measured pose."""


@dataclass(frozen=True, slots=True)
class Normal:
    """The normal equations after the angles were eliminated, and what brings these back."""

    matrix: Array
    """6f x 6f of the free cameras, in units of the residuals' standard deviation."""
    right: Array
    angles_matrix: Array
    """k x joints x joints, inverted."""
    angles_right: Array
    coupling: Array
    """k x 6f x joints."""

    def angle_step(self, camera_step: Array) -> Array:
        """K x joints: what the angles do when the cameras do this."""
        rest = self.angles_right - np.einsum("kcj,c->kj", self.coupling, camera_step)
        return np.asarray(np.einsum("kij,kj->ki", self.angles_matrix, rest))


def linearise(problem: Problem, state: State) -> Linear:
    """Residuals and their derivatives, in closed form."""
    points, change = problem.arm.centres(state.angles)
    world, world_change = points[problem.pose, problem.marker], change[problem.pose, problem.marker]
    count = len(problem.camera)
    residuals, by_camera = np.zeros((count, 2)), np.zeros((count, 2, 6))
    by_angles = np.zeros((count, 2, problem.arm.joints))
    for index, (lens, camera) in enumerate(zip(problem.lenses, state.cameras, strict=True)):
        own = problem.camera == index
        seen = camera.seen(world[own])
        seen[:, 2] = np.maximum(seen[:, 2], 1e-3)  # behind the camera: far away from what was measured, and finite
        pixels, slope = project(lens, seen)
        residuals[own] = pixels - problem.pixels[own]
        # the camera turns by w in its own frame: R exp(w), and points turn back
        by_camera[own, :, :3] = slope @ cross_matrix(seen)
        by_camera[own, :, 3:] = -slope @ camera.rotation.T
        by_angles[own] = slope @ (camera.rotation.T @ world_change[own])
    return Linear(residuals, by_camera, by_angles)


def moved(problem: Problem, state: State, camera_step: Array, angle_step: Array) -> State:
    """The state after a step: 6 numbers for each free camera, joints for each pose."""
    cameras = list(state.cameras)
    for row, index in enumerate(problem.free):
        step = camera_step[6 * row : 6 * row + 6]
        cameras[index] = CameraPose(cameras[index].rotation @ turn(step[:3]), cameras[index].position + step[3:])
    return State(tuple(cameras), state.angles + angle_step)


def normal_equations(problem: Problem, linear: Linear, weight: Array, damping: float = 0.0) -> Normal:
    """Of the linearised problem.

    Args:
        problem: what was measured.
        linear: of a state.
        weight: n, of the squared residuals, 1 / px^2.
        damping: share by which diagonals grow.
    """
    free, joints, poses = problem.free, problem.arm.joints, problem.poses
    size = 6 * len(free)
    row_of = np.full(len(problem.lenses), -1)
    row_of[list(free)] = np.arange(len(free))
    wide = np.zeros((len(weight), 2, size))
    for index in free:
        own, row = problem.camera == index, int(row_of[index])
        wide[own, :, 6 * row : 6 * row + 6] = linear.by_camera[own]
    scaled = wide * weight[:, None, None]
    matrix = np.einsum("nic,nid->cd", scaled, wide)
    right = -np.einsum("nic,ni->c", scaled, linear.residuals)
    inverse, angles_right = np.zeros((poses, joints, joints)), np.zeros((poses, joints))
    coupling = np.zeros((poses, size, joints))
    matrix[np.diag_indices(size)] *= 1 + damping
    if problem.angles_known:
        return Normal(matrix, right, inverse, angles_right, coupling)
    own = np.zeros((poses, joints, joints))
    np.add.at(own, problem.pose, np.einsum("nia,nib,n->nab", linear.by_angles, linear.by_angles, weight))
    np.add.at(angles_right, problem.pose, -np.einsum("nia,ni,n->na", linear.by_angles, linear.residuals, weight))
    np.add.at(coupling, problem.pose, np.einsum("nic,nia->nca", scaled, linear.by_angles))
    diagonal = np.arange(joints)
    own[:, diagonal, diagonal] = own[:, diagonal, diagonal] * (1 + damping) + _VAGUE_RAD**-2
    inverse = np.linalg.inv(own)
    reduced = coupling @ inverse
    matrix -= np.einsum("kcj,kdj->cd", reduced, coupling)
    right -= np.einsum("kcj,kj->c", reduced, angles_right)
    return Normal(matrix, right, inverse, angles_right, coupling)


def solve(problem: Problem, start: State, *, robust: bool) -> State:
    """The state that fits best, from one that is near it.

    Args:
        problem: what was measured.
        start: where to begin.
        robust: whether what is far off counts less.
    """
    state, damping = start, 1e-4
    linear = linearise(problem, state)
    cost = _cost(problem, linear, robust=robust)
    for _ in range(_STEPS):
        weight = _weights(problem, linear, robust=robust)
        normal = normal_equations(problem, linear, weight, damping)
        # scaled by its diagonal: radians and metres
        scale = 1.0 / np.sqrt(np.maximum(np.diag(normal.matrix), 1e-12))
        step = scale * np.linalg.lstsq(normal.matrix * scale * scale[:, None], scale * normal.right, rcond=1e-13)[0]
        trial = moved(problem, state, step, normal.angle_step(step))
        trial_linear = linearise(problem, trial)
        trial_cost = _cost(problem, trial_linear, robust=robust)
        if not trial_cost < cost:
            damping *= 10.0
            if damping > 1e8:
                break
            continue
        gain, cost = cost - trial_cost, trial_cost
        state, linear, damping = trial, trial_linear, max(damping / 10.0, 1e-12)
        if gain < _SMALL * cost:
            break
    return state


def without_outliers(problem: Problem, state: State, most: float = 4.0) -> Problem:
    """Centres that are farther from where they should be than so many standard deviations are left out."""
    apart = _scaled(problem, linearise(problem, state))
    used = problem.weight > 0
    spread = _spread(apart[used])
    return replace(problem, weight=np.where(apart > most * spread, 0.0, problem.weight))


def information(problem: Problem, state: State) -> Normal:
    """What the measurements say of the cameras: the covariance's inverse, by the spread that residuals really have."""
    linear = linearise(problem, state)
    used = problem.weight > 0
    spread = _spread(_scaled(problem, linear)[used])
    return normal_equations(problem, linear, (problem.weight / (_SIGMA_PX * spread)) ** 2)


def _scaled(problem: Problem, linear: Linear) -> Array:
    """Distances in standard deviations."""
    return np.asarray(np.linalg.norm(linear.residuals, axis=1) * problem.weight / _SIGMA_PX)


def _spread(apart: Array) -> float:
    """Standard deviation of each coordinate, from the median distance of normal errors in two dimensions."""
    return max(float(np.median(apart)) / 1.1774, 1e-3) if apart.size else 1.0


def _weights(problem: Problem, linear: Linear, *, robust: bool) -> Array:
    weight = (problem.weight / _SIGMA_PX) ** 2
    if robust:
        weight = weight / (1 + (_scaled(problem, linear) / _ROBUST) ** 2)
    return np.asarray(weight)


def _cost(problem: Problem, linear: Linear, *, robust: bool) -> float:
    squares = _scaled(problem, linear) ** 2
    return float((_ROBUST**2 * np.log1p(squares / _ROBUST**2)).sum() if robust else squares.sum())
