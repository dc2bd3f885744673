"""What the report measures; each function takes a running stack and returns figures."""

import csv
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import resources

import numpy as np

from armsight.v1.control_pb2 import IK_STATUS_CONVERGED
from armsight_operator.report import fixed_scale
from armsight_operator.report.chain import OBSERVABLE_RAD, Arm, Array, Flags, tip_from_markers
from armsight_operator.report.markers import Sample, samples_of
from armsight_operator.report.run import Instant, Run, centres

Progress = Callable[[float], None]

# Of sin(pi t / period) for each joint: the motions that the report evaluates on.
PART1_PERIODS = (0.0, 15.0, 20.0, 18.0)
PART2_PERIODS = (28.0, 0.0, 20.0, 18.0)
# Ours, of all joints at once: no two of them are in a ratio of whole numbers.
ALL_PERIODS = tuple(10 * math.sqrt(prime) for prime in (7, 2, 5, 3))


@dataclass(frozen=True, slots=True)
class PoseRow:
    """One of the ten configurations: base frame, metres."""

    theta: float
    phi: float
    psi: float
    measured: Array
    """By the pipeline."""
    truth: Array
    """K of the true angles."""
    report_measured: Array
    """As the report prints it."""
    report_method: Array
    """The report's method on the frames that the pipeline had."""


@dataclass(frozen=True, slots=True)
class Part:
    """A test motion: angles of every instant, and which of them counts."""

    name: str
    symbols: tuple[str, ...]
    joints: tuple[int, ...]
    """The free ones, in the order of the symbols."""
    time_s: Array
    estimated: Array
    """instants x free joints, rad."""
    true: Array
    observable: Flags
    """instants x free joints: whether 2 mm of marker noise moves the joint by less than 10 mrad there."""
    markers: list[Sample]

    @property
    def error(self) -> Array:
        """Estimated minus true, never modulo anything."""
        return self.estimated - self.true


@dataclass(frozen=True, slots=True)
class Random:
    """Random configurations of all joints: distance of the measured from the true end effector, metres."""

    seed: int
    error: Array
    """poses x 3."""
    markers: list[Sample]


@dataclass(frozen=True, slots=True)
class Descent:
    """Success of the report's gradient descent from one kind of start."""

    initialisation: str
    targets: int
    converged: int


def mean_squared(error: Array) -> float:
    """Mean over all poses and axes, m²: the report's figure."""
    return float(np.mean(np.square(error)))


def table1(run: Run, progress: Progress) -> list[PoseRow]:
    """The ten configurations, set at rest."""
    calibration = run.calibration(run.cameras[0])
    pose = run.camera_pose(run.cameras[0])
    distance = float(np.hypot(pose.translation.x, pose.translation.y))
    scale = fixed_scale.metres_per_pixel(distance, calibration.K[0])
    text = resources.files("armsight_operator.report").joinpath("table1.csv").read_text(encoding="utf-8")
    rows = []
    printed = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(io.StringIO(text))]
    for index, row in enumerate(printed):
        q = np.array([row["theta"], 0.0, row["phi"], row["psi"]])
        since = run.reset(q)
        markers = run.markers_at(since)
        frames = [run.frames_at(since)[name] for name in run.cameras]
        rows.append(
            PoseRow(
                theta=row["theta"],
                phi=row["phi"],
                psi=row["psi"],
                measured=run.arm.to_base(tip_from_markers(run.arm, markers)),
                truth=run.arm.tip_at(q),
                report_measured=np.array([row["x"], row["y"], row["z"]]),
                report_method=fixed_scale.end_effector(frames[0], frames[1], scale, pose.translation.z),
            )
        )
        progress((index + 1) / len(printed))
    return rows


SYMBOLS = ("theta", "nu", "phi", "psi")
"""Of the joints of the report's arm."""

FREE = {"test-1": (1, 2, 3), "test-2": (0, 2, 3)}
"""Joints that move, by mode; all of them in the others."""


def part1(run: Run, begin_s: float, duration_s: float, progress: Progress) -> Part:
    """Joint 1 fixed at 0."""
    return _part(run, "test-1", PART1_PERIODS, (begin_s, duration_s), progress)


def part2(run: Run, begin_s: float, duration_s: float, progress: Progress) -> Part:
    """Joint 2 fixed at 0."""
    return _part(run, "test-2", PART2_PERIODS, (begin_s, duration_s), progress)


def all_joints(run: Run, begin_s: float, duration_s: float, progress: Progress) -> Part:
    """All four joints move."""
    return _part(run, "test-all", ALL_PERIODS, (begin_s, duration_s), progress)


def random_poses(run: Run, seed: int, count: int, progress: Progress) -> Random:
    """Random configurations of all four joints, within the limits, set at rest."""
    generator = np.random.default_rng(seed)
    errors = []
    samples: list[Sample] = []
    for index in range(count):
        q = generator.uniform(run.arm.limits[:, 0], run.arm.limits[:, 1])
        positions = run.positions_at(run.reset(q))
        errors.append(run.arm.to_base(tip_from_markers(run.arm, centres(positions))) - run.arm.tip_at(q))
        samples += samples_of(run.arm, positions, q, len(run.cameras))
        progress((index + 1) / count)
    return Random(seed, np.array(errors), samples)


def descents(run: Run, seed: int, count: int, progress: Progress) -> list[Descent]:
    """The report's three initialisations on the same random reachable targets (joint 2 at 0)."""
    generator = np.random.default_rng(seed)
    limits = run.arm.limits
    goals = generator.uniform(limits[:, 0], limits[:, 1], (count, len(limits)))
    goals[:, 1] = 0.0
    random_starts = generator.normal(0.0, 0.005, goals.shape)
    done, total = 0, 3 * count
    results = []
    for name in ("fixed", "previous", "random"):
        converged, previous = 0, random_starts[0]
        for goal, random_start in zip(goals, random_starts, strict=True):
            starts = {"fixed": np.full(len(limits), 0.5), "previous": previous, "random": random_start}
            begin = starts[name].copy()
            begin[1] = 0.0
            answer = run.solve_ik(run.arm.tip_at(goal), begin)
            converged += answer.status == IK_STATUS_CONVERGED
            previous = np.array([joint.position_rad for joint in answer.joints])
            done += 1
            progress(done / total)
        results.append(Descent(name, count, converged))
    return results


def _part(
    run: Run,
    mode: str,
    periods: tuple[float, ...],
    span_s: tuple[float, float],
    progress: Progress,
) -> Part:
    begin_s, duration_s = span_s
    run.hold()
    run.markers_at(run.reset(path(periods, begin_s)))
    instants = run.follow(mode, begin_s, duration_s, progress)
    return part_of(mode, instants, run.arm, len(run.cameras), begin_s)


def part_of(
    mode: str,
    instants: Sequence[Instant],
    arm: Arm,
    cameras: int,
    begin_s: float,
) -> Part:
    """A motion that was watched, live or recorded, beside its truth."""
    names = SYMBOLS if len(arm.names) == len(SYMBOLS) else arm.names
    joints = FREE.get(mode, tuple(range(len(names)))) if names is SYMBOLS else tuple(range(len(names)))
    free = list(joints)
    sigma = np.array([arm.sigma(instant.true, joints) for instant in instants])
    return Part(
        name=mode,
        symbols=tuple(names[joint] for joint in joints),
        joints=joints,
        time_s=begin_s + _seconds(instants),
        estimated=np.array([instant.estimated for instant in instants])[:, free],
        true=np.array([instant.true for instant in instants])[:, free],
        observable=sigma < OBSERVABLE_RAD,
        markers=[s for i in instants for s in samples_of(arm, i.positions, i.true, cameras)],
    )


def path(periods: tuple[float, ...], time_s: float) -> Array:
    """The test motion: joint 1 with amplitude pi, all others pi/2; a period of 0 stands for a fixed joint."""
    amplitudes = (np.pi, np.pi / 2, np.pi / 2, np.pi / 2)
    return np.array([a * np.sin(np.pi * time_s / p) if p else 0.0 for a, p in zip(amplitudes, periods, strict=True)])


def _seconds(instants: Sequence[Instant]) -> Array:
    stamps = np.array([instant.capture_ns for instant in instants], dtype=np.int64)
    return np.asarray((stamps - stamps[0]) * 1e-9)
