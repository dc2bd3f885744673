"""Camera poses from the arm's own markers: measures, begins, adjusts, and refuses what is not determined."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from armsight.errors import ConfigError
from armsight.v1.description_pb2 import ArmDescription
from armsight_operator.calibrate.arm import MarkedArm, joint_vector, marked_arm
from armsight_operator.calibrate.bundle import Problem, State, information, linearise, solve, without_outliers
from armsight_operator.calibrate.errors import UndeterminedError
from armsight_operator.calibrate.footage import Footage
from armsight_operator.calibrate.frames import Picture
from armsight_operator.calibrate.gauge import distance_of, free_directions, in_words
from armsight_operator.calibrate.lens import Array, Lens
from armsight_operator.calibrate.rigid import CameraPose
from armsight_operator.calibrate.search import Rough, angles_and_cameras, cameras_at
from armsight_operator.calibrate.sightings import Looker, Sighting

LEAST_POSES = 8
LEAST_SEEN = 20
"""Centres of one camera."""
LEAST_VISIBLE = 0.4
"""Share of the disc: of less, where its middle is becomes a question of what hides it."""
LEAST_SPREAD = 0.02
"""Of the markers across the line that fits them best, as a share of along it."""
MOST_RMS_PX = 1.0
MOST_POSITION_SIGMA = 0.003
"""Of a camera's position, as a share of its distance."""
MOST_DIRECTION_SIGMA_RAD = 0.003
MOST_LEFT_OUT = 0.4
"""Share of centres that may be outliers."""

_ROUNDS = 3


@dataclass(frozen=True, slots=True)
class Measured:
    """What all cameras saw of the arm at all poses."""

    names: tuple[str, ...]
    lenses: tuple[Lens, ...]
    arm: MarkedArm
    poses: int
    """k, seen or not."""
    angles: Array | None
    """k x joints; none where they are not known."""
    sightings: Mapping[tuple[int, int], Sequence[Sighting]]
    """By camera's and pose's index."""
    samples: tuple[Picture, ...]
    """One picture of each camera, to draw over."""


@dataclass(frozen=True, slots=True)
class CameraFound:
    """One camera's pose, and how well it is known."""

    name: str
    pose: CameraPose
    held: bool
    rms_px: float
    at_markers_m: float
    """The same as a distance at the markers."""
    used: int
    left_out: int
    position_sigma_m: float
    direction_sigma_rad: float
    """Of the direction in which it looks; the turn about that is known as well or better than it matters."""
    pixels: Array
    """n x 2: the centres that were used."""
    residuals: Array
    """n x 2: measured less expected."""


@dataclass(frozen=True, slots=True)
class Extrinsics:
    """All cameras' poses."""

    cameras: tuple[CameraFound, ...]
    poses: int
    twins: int
    """Poses with unknown angles that have other angles at which every marker is at the same place."""


def measure(footage: Footage, description: ArmDescription, lenses: Mapping[str, Lens]) -> Measured:
    """Looks at every picture.

    Raises:
        ConfigError: pictures don't fit to the lens, or joints to the description.
        OperatorError: vision can't measure.
    """
    arm = marked_arm(description)
    names = tuple(name for name in footage.names if name in lenses)
    sightings: dict[tuple[int, int], list[Sighting]] = {}
    samples: dict[str, Picture] = {}
    looker = Looker(description)
    try:
        for pose, camera, picture in footage.pictures():
            if camera not in lenses:
                continue
            lens = lenses[camera]
            if picture.shape[:2] != (lens.height, lens.width):
                raise ConfigError(
                    f"camera {camera} is calibrated for pictures of {lens.width} x {lens.height}, not "
                    f"{picture.shape[1]} x {picture.shape[0]}: calibrate its intrinsics at this size"
                )
            samples.setdefault(camera, picture)
            found = looker.sightings(camera, lens, picture)
            sightings[names.index(camera), pose] = [each for each in found if each.marker in arm.markers]
    finally:
        looker.close()
    angles = None
    told = [instant.joints for instant in footage.instants if instant.joints is not None]
    if told:
        angles = np.array([joint_vector(arm, joints) for joints in told])
    missing = [name for name in names if name not in samples]
    if missing or not names:
        raise ConfigError(
            f"{footage.source} has no pictures of camera {', '.join(missing) or 'any'} at the chosen instants"
        )
    return Measured(
        names=names,
        lenses=tuple(lenses[name] for name in names),
        arm=arm,
        poses=len(footage.instants),
        angles=angles,
        sightings=sightings,
        samples=tuple(samples[name] for name in names),
    )


def calibrate(measured: Measured, approximate: Mapping[str, CameraPose], hold: Sequence[str] = ()) -> Extrinsics:
    """The cameras' poses.

    Args:
        measured: what the cameras saw.
        approximate: by camera; needed where angles are unknown, and of cameras that are held.
        hold: cameras whose pose is right as it is.

    Raises:
        ConfigError: no approximate pose where one is needed.
        UndeterminedError: the pictures don't determine the poses; with everything that is missing.
    """
    held = frozenset(measured.names.index(name) for name in hold)
    problem = _problem(measured, held)
    if troubles := _too_little(measured, problem):
        raise UndeterminedError("the pictures don't determine where cameras are: " + "; ".join(troubles))
    state, twins = _begin(measured, approximate, held)
    problem, state = _adjusted(problem, state)
    if disagreeing := _disagreeing(measured, problem):
        raise UndeterminedError("the pictures don't determine where cameras are: " + "; ".join(disagreeing))
    if on_line := _on_one_line(measured, problem, state):
        raise UndeterminedError(
            f"camera {', '.join(on_line)} sees all markers on one line, about which it could turn: move all joints"
        )
    normal = information(problem, state)
    if problem.free and (left_open := free_directions(problem, state, normal)):
        said = "; ".join(in_words(problem, state, normal, direction, measured.names) for direction in left_open)
        mend = (
            "give --angles accepted, or --hold-camera of one whose pose is right"
            if measured.angles is None
            else "record more poses, with all joints moved"
        )
        raise UndeterminedError(f"nothing that was seen changes when {said}: {mend}")
    found = Extrinsics(_cameras(measured, problem, state, normal.matrix), len(np.unique(problem.pose)), twins)
    if troubles := doubts(found, problem, state):
        raise UndeterminedError("the pictures don't determine where cameras are: " + "; ".join(troubles))
    return found


def doubts(found: Extrinsics, problem: Problem, state: State) -> list[str]:
    """Why poses are not to be trusted, and what to do; nothing where they are."""
    distance, troubles = distance_of(problem, state), []
    for camera in found.cameras:
        if not camera.rms_px <= MOST_RMS_PX:
            troubles.append(
                f"camera {camera.name}: centres are {camera.rms_px:.2f} px from where they should be, at most "
                f"{MOST_RMS_PX:g} is right: its intrinsics, the description of the arm or the angles are wrong"
            )
        if not camera.position_sigma_m <= MOST_POSITION_SIGMA * distance:
            troubles.append(
                f"camera {camera.name}: its position is uncertain by {camera.position_sigma_m * 1e3:.0f} mm: record "
                "more poses, with all joints moved"
            )
        if not camera.direction_sigma_rad <= MOST_DIRECTION_SIGMA_RAD:
            troubles.append(
                f"camera {camera.name}: its direction is uncertain by {camera.direction_sigma_rad * 1e3:.1f} mrad: "
                "record more poses, with all joints moved"
            )
    return troubles


def _problem(measured: Measured, held: frozenset[int]) -> Problem:
    rows = [
        (camera, pose, measured.arm.markers.index(each.marker), *each.pixel, _weight(each.visible))
        for (camera, pose), found in sorted(measured.sightings.items())
        for each in found
        if each.visible >= LEAST_VISIBLE
    ]
    table = np.array(rows, dtype=np.float64).reshape(-1, 6)
    camera_of, pose_of, marker_of = table[:, :3].T.astype(np.intp)
    return Problem(
        arm=measured.arm,
        poses=measured.poses,
        lenses=measured.lenses,
        camera=camera_of,
        pose=pose_of,
        marker=marker_of,
        pixels=table[:, 3:5],
        weight=table[:, 5],
        held=held,
        angles_known=measured.angles is not None,
    )


def _weight(visible: float) -> float:
    return visible**4  # of 0.7, errors are four times those of whole spheres


def _too_little(measured: Measured, problem: Problem) -> list[str]:
    troubles = []
    poses = len(np.unique(problem.pose))
    if poses < LEAST_POSES:
        troubles.append(
            f"the arm is seen at {poses} poses, at least {LEAST_POSES} are needed: record more, all joints moved"
        )
    for index, name in enumerate(measured.names):
        seen = int((problem.camera == index).sum())
        if seen < LEAST_SEEN:
            troubles.append(
                f"camera {name} sees {seen} markers in all pictures, at least {LEAST_SEEN} are needed: turn it to "
                "the arm, check the markers' colours"
            )
    return troubles


def _disagreeing(measured: Measured, problem: Problem) -> list[str]:
    """Cameras too many of whose centres are outliers: what is left would tell a pose by chance."""
    troubles = []
    for index, name in enumerate(measured.names):
        own = problem.weight[problem.camera == index]
        left_out = int((own == 0).sum())
        if left_out > MOST_LEFT_OUT * len(own):
            pose = "with the pose that is held" if index in problem.held else "with any pose"
            troubles.append(
                f"camera {name}: {left_out} of {len(own)} centres don't agree {pose}: check the markers' colours "
                "(`armsight calibrate colours`), intrinsics and angles"
            )
    return troubles


def _on_one_line(measured: Measured, problem: Problem, state: State) -> list[str]:
    points, _ = problem.arm.centres(state.angles)
    found = []
    for index, name in enumerate(measured.names):
        used = (problem.camera == index) & (problem.weight > 0)
        if index in problem.held:
            continue
        seen = points[problem.pose[used], problem.marker[used]]
        spread = np.linalg.svd(seen - seen.mean(axis=0), compute_uv=False)
        if spread[1] < LEAST_SPREAD * spread[0]:
            found.append(name)
    return found


def _begin(measured: Measured, approximate: Mapping[str, CameraPose], held: frozenset[int]) -> tuple[State, int]:
    rough = _rough(measured)
    missing = [name for name in measured.names if name not in approximate]
    needed = missing if measured.angles is None else [measured.names[i] for i in held if measured.names[i] in missing]
    if needed:
        raise ConfigError(
            f"no pose of camera {', '.join(needed)} is known, not even about: put it into the file, or record it"
        )
    if measured.angles is not None:
        cameras = cameras_at(measured.arm, rough, measured.angles)
        for index in held:
            cameras[index] = approximate[measured.names[index]]
        return State(tuple(cameras), measured.angles), 0
    q, cameras, twins = angles_and_cameras(measured.arm, rough, [approximate[name] for name in measured.names], held)
    return State(tuple(cameras), q), twins


def _rough(measured: Measured) -> Rough:
    shape = (len(measured.names), measured.poses, len(measured.arm.markers))
    places, weight = np.zeros((*shape, 3)), np.zeros(shape)
    for (camera, pose), found in measured.sightings.items():
        for each in found:
            at = camera, pose, measured.arm.markers.index(each.marker)
            places[at], weight[at] = each.place, each.visible**2
    return Rough(places, weight)


def _adjusted(problem: Problem, state: State) -> tuple[Problem, State]:
    state = solve(problem, state, robust=False)
    state = solve(problem, state, robust=True)
    whole = problem
    for _ in range(_ROUNDS):
        problem = without_outliers(whole, state)
        state = solve(problem, state, robust=False)
    return problem, state


def _cameras(measured: Measured, problem: Problem, state: State, matrix: Array) -> tuple[CameraFound, ...]:
    linear = linearise(problem, state)
    covariance = np.linalg.inv(matrix) if problem.free else np.zeros((0, 0))
    points, _ = problem.arm.centres(state.angles)
    found = []
    for index, name in enumerate(measured.names):
        own = problem.camera == index
        used = own & (problem.weight > 0)
        pose, lens = state.cameras[index], measured.lenses[index]
        away = pose.seen(points[problem.pose[used], problem.marker[used]])
        apart = np.linalg.norm(linear.residuals[used], axis=1)
        variance = np.zeros(6)
        if index in problem.free:
            row = problem.free.index(index)
            variance = np.diag(covariance)[6 * row : 6 * row + 6]
        found.append(
            CameraFound(
                name=name,
                pose=pose,
                held=index in problem.held,
                rms_px=float(np.sqrt((apart**2).mean())) if apart.size else float("nan"),
                at_markers_m=float(np.sqrt(((apart * away[:, 2] / lens.focal.mean()) ** 2).mean()))
                if apart.size
                else 0.0,
                used=int(used.sum()),
                left_out=int(own.sum() - used.sum()),
                position_sigma_m=float(np.sqrt(variance[3:].sum())),
                direction_sigma_rad=float(np.sqrt(variance[:2].sum())),
                pixels=problem.pixels[used],
                residuals=-linear.residuals[used],
            )
        )
    return tuple(found)
