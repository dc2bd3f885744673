"""What measurements leave open, found in the normal equations and said in words."""

from collections.abc import Sequence

import numpy as np

from armsight_operator.calibrate.bundle import Normal, Problem, State
from armsight_operator.calibrate.lens import Array

FREE = 0.05
"""A direction in which cameras may be off by this share of their distance is not determined at all."""

_COMMON = 0.02
"""Share of a direction that may be left when it is taken for one movement of all cameras together."""
_ON_AXIS = 0.02


def distance_of(problem: Problem, state: State) -> float:
    """From the cameras to the arm, metres, on average."""
    points, _ = problem.arm.centres(state.angles)
    middle = points.reshape(-1, 3).mean(axis=0)
    return float(np.mean([np.linalg.norm(camera.position - middle) for camera in state.cameras]))


def free_directions(problem: Problem, state: State, normal: Normal) -> list[Array]:
    """Steps of the free cameras' unknowns, 6f each, that hardly change what they see; metres at the arm of length 1.

    Eigenvectors of the normal matrix with turns measured in metres at the arm's distance.
    """
    distance = distance_of(problem, state)
    scale = np.tile([1 / distance] * 3 + [1.0] * 3, len(problem.free))
    values, vectors = np.linalg.eigh(normal.matrix * scale * scale[:, None])
    least = 1 / (FREE * distance) ** 2
    return [scale * vectors[:, index] for index in np.flatnonzero(values < least)]


def in_words(problem: Problem, state: State, normal: Normal, direction: Array, names: Sequence[str]) -> str:
    """A direction that is not determined, as a person says it.

    Args:
        problem: what was measured.
        state: where it is left open.
        normal: of that state.
        direction: of :func:`free_directions`.
        names: of the cameras.
    """
    turns, shifts = [], []
    for row, index in enumerate(problem.free):
        step = direction[6 * row : 6 * row + 6]
        turns.append(state.cameras[index].rotation @ step[:3])
        shifts.append(step[3:])
    who = [names[index] for index in problem.free]
    common = _common(problem, state, np.array(turns), np.array(shifts))
    subject = f"camera {who[0]}" if len(who) == 1 else f"cameras {', '.join(who[:-1])} and {who[-1]} together"
    if common is None:
        size = [
            float(np.linalg.norm(shift) + np.linalg.norm(turned)) for shift, turned in zip(shifts, turns, strict=True)
        ]
        parts = [
            f"camera {name} {_movement(turned, shift)}"
            for name, turned, shift, part in zip(who, turns, shifts, size, strict=True)
            if part > 0.1 * max(size)
        ]
        return " while ".join(parts)
    turned, shift = common
    verb = "turns" if len(who) == 1 else "turn"
    if np.linalg.norm(turned) * distance_of(problem, state) < 0.1 * np.linalg.norm(shift):
        return f"{subject} {'moves' if len(who) == 1 else 'move'} along {_rounded(shift)}"
    axis = turned / np.linalg.norm(turned)
    where = np.cross(turned, shift) / float(turned @ turned)
    origin, first = problem.arm.first_axis
    off = (where - origin) - ((where - origin) @ first) * first
    along = abs(axis @ first)
    if along > 1 - _ON_AXIS**2 and np.linalg.norm(off) < _ON_AXIS * distance_of(problem, state):
        return f"{subject} {verb} about {problem.arm.arm.names[0]}'s axis" + _with_joints(
            problem, normal, direction, turned
        )
    return f"{subject} {verb} about {_rounded(axis)} through {_rounded(where)}" + _with_joints(
        problem, normal, direction, turned
    )


def _common(problem: Problem, state: State, turns: Array, shifts: Array) -> tuple[Array, Array] | None:
    """The one movement, a turn and a shift of the world, that all of these are; none where they are not.

    A camera at p that moves with the world turns by w and shifts by w x p + v.
    """
    if problem.held:
        return None
    distance = distance_of(problem, state)
    rows, right = [], []
    for index, turned, shift in zip(problem.free, turns, shifts, strict=True):
        x, y, z = state.cameras[index].position
        cross = np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])  # w -> w x p
        rows += [np.hstack([distance * np.eye(3), np.zeros((3, 3))]), np.hstack([cross, np.eye(3)])]
        right += [distance * turned, shift]
    matrix, values = np.vstack(rows), np.concatenate(right)
    found, *_ = np.linalg.lstsq(matrix, values, rcond=None)
    if np.linalg.norm(matrix @ found - values) > _COMMON * np.linalg.norm(values):
        return None
    return found[:3], found[3:]


def _with_joints(problem: Problem, normal: Normal, direction: Array, turned: Array) -> str:
    """Which unknown angles go with it."""
    if problem.angles_known:
        return ""
    # a step along the direction and nothing else
    change = -np.einsum("kij,kcj,c->ki", normal.angles_matrix, normal.coupling, direction)
    share = np.median(np.abs(change), axis=0) / np.linalg.norm(turned)
    going = [name for name, part in zip(problem.arm.arm.names, share, strict=True) if part > 0.5]
    return f", and {' and '.join(going)} with {'it' if len(going) == 1 else 'them'}" if going else ""


def _movement(turned: Array, shift: Array) -> str:
    parts = []
    if np.linalg.norm(turned) > 1e-6:
        parts.append(f"turns about {_rounded(turned / np.linalg.norm(turned))}")
    if np.linalg.norm(shift) > 1e-6:
        parts.append(f"moves along {_rounded(shift)}")
    return " and ".join(parts)


def _rounded(vector: Array) -> str:
    return "(" + ", ".join(f"{value + 0.0:.2g}" for value in np.round(vector, 3)) + ")"
