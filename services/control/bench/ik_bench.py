"""Inverse kinematics: success, time, and behaviour out of reach, of this package's solvers and of others, in one run.

    python services/control/bench/ik_bench.py --targets 1000 --json ik.json
    python services/control/bench/ik_bench.py --peers roboticstoolbox-python placo

Targets are the tips of uniform random configurations inside the limits, so all of them can be reached; starts are
uniform as well. Solvers are interleaved target by target, so that a busy machine slows all of them alike; one thread.
The judge is a forward kinematics in double precision, not what a solver says of itself. Out of reach: the exercise's
own target, which leaves the reach and comes back, followed at 100 Hz from one solution to the next.
"""

import argparse
import json
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from time import perf_counter

import numpy as np
import torch
from ik_peers import ALWAYS, PEERS, Remote

from armsight_control.chain import Array, Chain, Point
from armsight_control.kinematics import forward, links_of
from armsight_control.solvers import REPORT_FREE, Problem, closed_form, solve, solve_batch
from armsight_control.solvers.start import INITIALISATIONS, Initialisation, start
from armsight_control.solvers.workspace import Moving, nearest_reachable

SUCCESS_M, EXACT_M = 0.005, 1e-6
# The report's descent takes 0.1 s a target: a part of the targets tells its share well enough.
_DESCENTS = 100
_PATH_S, _PATH_HZ = 20.0, 100
# Some peers take a third of a second for a target out of reach: they are followed as far as they get in this time.
_FOLLOW_BUDGET_S = 90.0
_ENVIRONMENTS = Path(__file__).parents[3] / "build" / "ik-peers"

_QUARTER = np.pi / 2
CHAIN = Chain(
    names=("joint1", "joint2", "joint3", "joint4"),
    origins=np.array([[0, 0, 0], [0, 0, 4.0], [0, 0, 0], [0, 0, 3.2]]),
    axes=np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float64),
    limits=np.array([[-np.pi, np.pi], [-_QUARTER, _QUARTER], [-_QUARTER, _QUARTER], [-_QUARTER, _QUARTER]]),
    max_speed=np.full(4, 5.0),
    tip=Point(3, np.array([0, 0, 2.8])),
)
FREE = {3: REPORT_FREE, 4: (0, 1, 2, 3)}

Solve = Callable[[Array, Array], tuple[Array, float]]
"""From a target and a start of the free joints to a solution and the seconds it took."""


@dataclass(frozen=True, slots=True)
class Row:
    """What one solver did with so many joints."""

    solver: str
    joints: int
    own_tolerance: float
    """Share of targets with a mean absolute error below the report's 0.005 m."""
    success: float
    """Share of targets reached within 0.005 m, Euclidean, inside the limits."""
    exact: float
    """The same within 1e-6 m."""
    worst_m: float
    median_ms: float
    p99_ms: float
    batch_ms: float | None
    """All targets in one call, best of three; nothing where there is no such call."""
    above_best_m: float | None
    """Along the path: the largest distance to the target above that of the nearest reachable point."""
    largest_step_rad: float | None
    """Along the path: of any joint from one target to the next."""
    followed_s: float | None
    """As far along the path as the solver came; less than its end where solving took too long."""


@dataclass(slots=True)
class Entry:
    """A solver under test, and what it did so far."""

    solve: Solve
    most: int | None = None
    """Targets to try it with; all where nothing is said."""
    batch: Callable[[Array, Array], object] | None = None
    follows: bool = True
    solutions: list[Array] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)


def measure(targets: int, seed: int, joints: int, peers: Sequence[str]) -> list[Row]:
    """Runs all solvers on the same seeded targets."""
    torch.set_num_threads(1)
    rng = np.random.default_rng([seed, joints])
    free = list(FREE[joints])
    limits = CHAIN.limits[free]
    goals, begins = (rng.uniform(limits[:, 0], limits[:, 1], size=(targets, joints)) for _ in range(2))
    aims = tips_of(goals)
    remotes = {name: Remote(name, joints, _ENVIRONMENTS) for name in peers}
    entries = _ours(joints, rng) | _peers(joints) | {name: Entry(one.solve) for name, one in remotes.items()}
    for entry in entries.values():
        entry.solve(aims[0], begins[0])  # the first call loads and warms up
    for i, (aim, begin) in enumerate(zip(aims, begins, strict=True)):
        for remote in remotes.values():
            remote.posture = goals[i]
        for entry in entries.values():
            if entry.most is None or i < entry.most:
                q, seconds = entry.solve(aim, begin)
                entry.solutions.append(q)
                entry.seconds.append(seconds)
    for remote in remotes.values():
        remote.posture = None
    rows = [_row(name, joints, entry, aims, begins) for name, entry in entries.items()]
    for remote in remotes.values():
        remote.close()
    return rows


def tips_of(q: Array) -> Array:
    """The tip of configurations (..., 3 or 4) of the free joints."""
    full = np.zeros((*q.shape[:-1], CHAIN.count))
    full[..., FREE[q.shape[-1]]] = q
    return forward(CHAIN, full)


def path() -> Array:
    """The exercise's own target, base frame."""
    t = np.arange(0, _PATH_S, 1 / _PATH_HZ)
    places = [3 * np.cos(math.pi * t / 20), 4 * np.sin(math.pi * t / 14) + 0.5, np.sin(math.pi * t / 18) + 4.5]
    return np.stack(places, axis=1)


def _timed(solver: Callable[[Array, Array], Array]) -> Solve:
    def run(target: Array, begin: Array) -> tuple[Array, float]:
        began = perf_counter()
        q = solver(target, begin)
        return q, perf_counter() - began

    return run


def _ours(joints: int, rng: np.random.Generator) -> dict[str, Entry]:
    free = FREE[joints]

    def full(begin: Array) -> Array:
        q = np.zeros((*begin.shape[:-1], CHAIN.count))
        q[..., free] = begin
        return q

    def entry(name: str) -> Entry:
        return Entry(
            _timed(lambda target, begin: solve(name, Problem(CHAIN, target, full(begin), free)).q[list(free)]),
            batch=lambda aims, begins: solve_batch(name, CHAIN, aims, full(begins), free),
        )

    entries = {name: entry(name) for name in ("torch", "levenberg-marquardt", "closed-form")}
    if joints == 3:
        links, limits = links_of(CHAIN), CHAIN.limits[list(free)].tolist()

        def alone(target: Array, begin: Array) -> tuple[Array, float]:
            goal, first = target.tolist(), begin.tolist()
            began = perf_counter()
            q = closed_form.solve_one(links, limits, goal, first)
            seconds = perf_counter() - began
            return np.array(q), seconds

        # without looking whether the target is within reach, and without arrays
        entries["closed-form, the formulas alone"] = Entry(
            alone, batch=lambda aims, begins: closed_form.solve_batch(links, aims, begins), follows=False
        )
        entries |= {f"gradient descent, {name}": _descent(name, rng) for name in INITIALISATIONS}
    return entries


def _descent(initialisation: Initialisation, rng: np.random.Generator) -> Entry:
    previous: list[Array] = []

    def run(target: Array, begin: Array) -> Array:
        del begin  # the report has its own
        first = start(CHAIN, initialisation, previous[-1] if previous else None, rng)
        solution = solve("gradient-descent", Problem(CHAIN, target, first, REPORT_FREE))
        previous[:] = [solution.q]
        return solution.q[list(REPORT_FREE)]

    return Entry(_timed(run), most=_DESCENTS, follows=False)


def _peers(joints: int) -> dict[str, Entry]:
    return {name: Entry(_timed(PEERS[name](joints).solve)) for name in ALWAYS}


def _row(name: str, joints: int, entry: Entry, aims: Array, begins: Array) -> Row:
    q = np.array(entry.solutions)
    errors = tips_of(q) - aims[: len(q)]
    distance = np.linalg.norm(errors, axis=1)
    limits = CHAIN.limits[list(FREE[joints])]
    inside = ((q >= limits[:, 0] - 1e-9) & (q <= limits[:, 1] + 1e-9)).all(axis=1)
    above, step, followed_s = _followed(entry, joints) if entry.follows else (None, None, None)
    return Row(
        solver=name,
        joints=joints,
        own_tolerance=float((np.abs(errors).mean(axis=1) < SUCCESS_M).mean()),
        success=float(((distance < SUCCESS_M) & inside).mean()),
        exact=float(((distance < EXACT_M) & inside).mean()),
        worst_m=float(distance.max()),
        median_ms=float(np.median(entry.seconds) * 1e3),
        p99_ms=float(np.percentile(entry.seconds, 99) * 1e3),
        batch_ms=None if entry.batch is None else _batch_ms(entry.batch, aims, begins),
        above_best_m=above,
        largest_step_rad=step,
        followed_s=followed_s,
    )


def _batch_ms(batch: Callable[[Array, Array], object], aims: Array, begins: Array) -> float:
    taken = []
    for _ in range(4):
        began = perf_counter()
        batch(aims, begins)
        taken.append((perf_counter() - began) * 1e3)
    return min(taken[1:])


def _followed(entry: Entry, joints: int) -> tuple[float, float, float]:
    moving: Moving = "all four" if joints == 4 else "joint 2 at 0"
    links = links_of(CHAIN)
    q = np.array([0.3, 0.0, -0.9, 0.9])[list(FREE[joints])]
    above, steps = [], []
    began = perf_counter()
    for i, target in enumerate(path()):
        if perf_counter() - began > _FOLLOW_BUDGET_S:
            break
        found, _ = entry.solve(target, q)
        best = np.linalg.norm(nearest_reachable(links, target, 0.0, moving)[0] - target)
        above.append(float(np.linalg.norm(tips_of(found) - target) - best))
        if i > 0:
            steps.append(float(np.abs(found - q).max()))
        q = found
    return max(above), max(steps), len(above) / _PATH_HZ


def _table(rows: Sequence[Row]) -> None:
    titles = (
        "solver",
        "joints",
        "< 5 mm",
        "< 1 µm",
        "median ms",
        "p99 ms",
        "batch ms",
        "above best m",
        "step rad",
        "for s",
    )
    print(f"{titles[0]:32}" + "".join(f"{title:>13}" for title in titles[1:]))
    for row in rows:
        ends = (row.batch_ms, row.above_best_m, row.largest_step_rad, row.followed_s)
        print(
            f"{row.solver:32}{row.joints:13}{row.success:13.1%}{row.exact:13.1%}{row.median_ms:13.4f}{row.p99_ms:13.3f}"
            + "".join(f"{'':>13}" if value is None else f"{value:13.3f}" for value in ends)
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints a table; writes JSON where asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--targets", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--joints", type=int, nargs="+", choices=tuple(FREE), default=list(FREE))
    optional = [name for name in PEERS if name not in ALWAYS]
    parser.add_argument(
        "--peers",
        nargs="*",
        choices=optional,
        default=[],
        metavar="NAME",
        help=f"beside {', '.join(ALWAYS)}: {', '.join(optional)}; each is installed under build/ik-peers",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows there, `-` for standard output")
    options = parser.parse_args(arguments)
    rows = [row for joints in options.joints for row in measure(options.targets, options.seed, joints, options.peers)]
    document = json.dumps([asdict(row) for row in rows], indent=2)
    if options.json is not None and str(options.json) == "-":
        print(document)
        return 0
    if options.json is not None:
        options.json.write_text(document + "\n", encoding="utf-8")
    _table(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
