"""Keeps the aim of a mode with a target: the solver's branch, and the configuration carried on with the point.

The branch changes where a joint is at its limit: by the shortest way while the target is in reach, and while it is not
to where joint 1 can follow longest.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from armsight.counters import Counters
from armsight_control.aiming import BRANCH_RAD, Aim, aim
from armsight_control.chain import Array, Chain, farthest
from armsight_control.estimators.candidates import twins, within
from armsight_control.kinematics import links_of_report
from armsight_control.solvers import Options, Problem, Solution
from armsight_control.solvers.start import perturbed
from armsight_control.tracking import Moving, Target
from armsight_control.trajectory import MotionLimits

# Descents that go on from one another for one target that does not move, before it is left at that.
_MOST_DESCENTS = 60
# The solver's branch is better than the present one where it is nearer to the point by this much.
_BETTER_M = 0.01
# What a target does after this is not told by what it does now.
_FORESEEN_S = 20.0


@dataclass(frozen=True, slots=True)
class Solved:
    """The newest solution and what it is for."""

    target: Target
    solution: Solution


class Pointing:
    """From targets to aims; remembers the branch."""

    def __init__(
        self, limits: MotionLimits, options: Options, free: tuple[int, ...], seed: int, counters: Counters
    ) -> None:
        """Nothing is aimed at yet."""
        self._limits, self._options, self._free, self._counters = limits, options, free, counters
        self._rng = np.random.default_rng(seed)
        self.forget()

    def move(self, free: tuple[int, ...]) -> None:
        """Lets these joints move, and no others: the branch is chosen anew."""
        self._free = free
        self.forget()

    def forget(self) -> None:
        """Of another target or mode: the branch is chosen anew."""
        self.solution: Solution | None = None
        self._solved: Solved | None = None
        self.refusal = ""
        """Why there is no solution, as far as the solver said."""
        self._aimed: Array | None = None
        self._descents = 0

    def problem(self, chain: Chain, target: Target, setpoint: Array) -> Problem | None:
        """What is to be solved now: warm-started from the last solution, first of all from the setpoint."""
        start, solved = setpoint, self._solved
        if solved is not None:
            start = solved.solution.q
            if np.array_equal(solved.target.position, target.position):
                if solved.solution.converged or self._descents >= _MOST_DESCENTS:
                    return None
            else:
                self._descents = 0
        if solved is None or not solved.solution.converged:
            # straight poses are saddles of the error: a descent that starts on one exactly stays there
            start = perturbed(chain, start, self._free, self._rng)
        return Problem(chain, target.position, start, self._free, self._options)

    def solved(self, target: Target, solution: Solution) -> None:
        """Takes a solution for a target."""
        self._counters.add(f"ik_{solution.status.name.lower()}")
        self._descents += 1
        self.refusal = ""
        self._solved = Solved(target, solution)
        self.solution = solution

    def aim(self, chain: Chain, point: Moving, dt_s: float) -> tuple[Aim, bool] | None:
        """The configuration for a point, and whether it is on another branch than the last one.

        Nothing before the solver has chosen a branch.
        """
        solution = self.solution
        if solution is None:
            return None
        present = self._aimed
        if present is None:
            first = aim(chain, self._free, point, solution.q, dt_s)
            self._aimed = first.q
            return first, False
        found = aim(chain, self._free, point, present, dt_s)
        if not found.reachable:
            other = aim(chain, self._free, point, solution.q, dt_s)
            if math.dist(found.tip, point.position) - math.dist(other.tip, point.position) > _BETTER_M:
                found = other
        switched = farthest(found.q, present) > BRANCH_RAD
        if switched and not found.reachable:
            # there is time for a longer way: the nearest branch might be at its end when the target is back in reach
            found = max(
                (found, *self._twins(chain, point, dt_s, found)), key=lambda each: self._worth_s(chain, present, each)
            )
        self._aimed = found.q
        if switched:
            self._counters.add("branch_switch")
        return found, switched

    def _twins(self, chain: Chain, point: Moving, dt_s: float, found: Aim) -> Iterator[Aim]:
        """The same tip on the branch where joint 1 is half a turn away; other arms than the report's have none such."""
        if links_of_report(chain) is None:
            return
        for q in within(chain, twins(found.q)):
            yield aim(chain, self._free, point, q, dt_s)

    def _worth_s(self, chain: Chain, present: Array, other: Aim) -> float:
        """How long a branch goes on until joint 1 is at its limit, in which alone twins differ, less the way to it."""
        way_s = float(np.max(np.abs(other.q - present) / self._limits.speed(chain)))
        rate, (lower, upper) = float(other.velocity[0]), chain.limits[0]
        room = float(upper - other.q[0] if rate > 0 else other.q[0] - lower)
        return min(room / max(abs(rate), 1e-9), _FORESEEN_S) - way_s
