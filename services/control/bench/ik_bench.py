"""Success and time of inverse kinematics: the report's descent from its three initialisations, beside exact solvers.

    python services/control/bench/ik_bench.py --targets 200 --json ik.json

Targets are the tips of uniform random configurations inside the limits, joint 2 at 0: all of them are reachable. The
judge is the closed form's own forward kinematics in double precision, not what a solver says of itself. Solvers are
interleaved target by target, so that a busy machine slows all of them alike.
"""

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
import torch
from scipy.optimize import least_squares

from armsight_control.chain import Array, Chain, Point
from armsight_control.kinematics import Links, links_of, report_forward, report_jacobian
from armsight_control.solvers import Options, Problem, solve
from armsight_control.solvers.start import INITIALISATIONS, start

SUCCESS_M = 0.005

_QUARTER = np.pi / 2
CHAIN = Chain(
    names=("joint1", "joint2", "joint3", "joint4"),
    origins=np.array([[0, 0, 0], [0, 0, 4.0], [0, 0, 0], [0, 0, 3.2]]),
    axes=np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float64),
    limits=np.array([[-np.pi, np.pi], [-_QUARTER, _QUARTER], [-_QUARTER, _QUARTER], [-_QUARTER, _QUARTER]]),
    max_speed=np.full(4, 5.0),
    tip=Point(3, np.array([0, 0, 2.8])),
)
FREE = [0, 2, 3]


@dataclass(frozen=True, slots=True)
class Row:
    """What one solver did on all targets."""

    solver: str
    own_tolerance: float
    """Share of targets with a mean absolute error below the report's 0.005 m."""
    success: float
    """Share of targets reached within 0.005 m, Euclidean, inside the limits."""
    median_error_m: float
    median_ms: float
    p99_ms: float


def measure(targets: int, seed: int) -> list[Row]:
    """Runs all solvers on the same seeded targets."""
    torch.set_num_threads(1)
    rng = np.random.default_rng(seed)
    links = links_of(CHAIN)
    limits = CHAIN.limits[FREE]
    goals = report_forward(links, rng.uniform(limits[:, 0], limits[:, 1], size=(targets, 3)))
    solvers = _solvers(links, rng)
    errors: dict[str, list[Array]] = {name: [] for name in solvers}
    seconds: dict[str, list[float]] = {name: [] for name in solvers}
    inside: dict[str, list[bool]] = {name: [] for name in solvers}
    for solver in solvers.values():
        solver(goals[0])  # the first call loads and warms up
    for goal in goals:
        for name, solver in solvers.items():
            began = perf_counter()
            q = solver(goal)
            seconds[name].append(perf_counter() - began)
            errors[name].append(report_forward(links, q) - goal)
            inside[name].append(bool(((q >= limits[:, 0] - 1e-9) & (q <= limits[:, 1] + 1e-9)).all()))
    return [_row(name, np.array(errors[name]), np.array(inside[name]), np.array(seconds[name])) for name in solvers]


def _solvers(links: Links, rng: np.random.Generator) -> dict[str, Callable[[Array], Array]]:
    previous: list[Array] = []

    def descent(initialisation: str, options: Options) -> Callable[[Array], Array]:
        def run(goal: Array) -> Array:
            begin = start(CHAIN, initialisation, previous[-1] if previous else None, rng)  # type: ignore[arg-type]
            solution = solve("gradient-descent", Problem(CHAIN, goal, begin, options))
            if initialisation == "previous":
                previous.append(solution.q)
            return solution.q[FREE]

        return run

    def closed_form(goal: Array) -> Array:
        return solve("closed-form", Problem(CHAIN, goal, np.zeros(4))).q[FREE]

    def scipy_peer(goal: Array) -> Array:
        limits = CHAIN.limits[FREE]
        found = least_squares(
            lambda q: report_forward(links, q) - goal,
            rng.uniform(limits[:, 0], limits[:, 1]),
            jac=lambda q: report_jacobian(links, q),
            bounds=(limits[:, 0], limits[:, 1]),
        )
        return np.asarray(found.x)

    descents = {f"gradient descent, {name}": descent(name, Options()) for name in INITIALISATIONS}
    return {**descents, "closed form": closed_form, "scipy least_squares": scipy_peer}


def _row(name: str, errors: Array, inside: np.ndarray, seconds: Array) -> Row:
    distance = np.linalg.norm(errors, axis=1)
    return Row(
        solver=name,
        own_tolerance=float((np.abs(errors).mean(axis=1) < SUCCESS_M).mean()),
        success=float(((distance < SUCCESS_M) & inside).mean()),
        median_error_m=float(np.median(distance)),
        median_ms=float(np.median(seconds) * 1e3),
        p99_ms=float(np.percentile(seconds, 99) * 1e3),
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints a table; writes JSON where asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--targets", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows there, `-` for standard output")
    options = parser.parse_args(arguments)
    rows = measure(options.targets, options.seed)
    document = json.dumps([asdict(row) for row in rows], indent=2)
    if options.json is not None and str(options.json) == "-":
        print(document)
        return 0
    if options.json is not None:
        options.json.write_text(document + "\n", encoding="utf-8")
    print(f"{'solver':28} {'MAE < 5 mm':>10} {'< 5 mm':>8} {'median mm':>10} {'median ms':>10} {'p99 ms':>8}")
    for row in rows:
        print(
            f"{row.solver:28} {row.own_tolerance:10.1%} {row.success:8.1%} {row.median_error_m * 1e3:10.3f} "
            f"{row.median_ms:10.3f} {row.p99_ms:8.2f}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
