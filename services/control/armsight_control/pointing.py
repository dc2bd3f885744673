"""Keeps the aim of a mode with a target: the solver's branch, and the configuration carried on with the point."""

from dataclasses import dataclass

import numpy as np

from armsight.counters import Counters
from armsight_control.aiming import BRANCH_RAD, Aim, aim
from armsight_control.chain import Array, Chain
from armsight_control.solvers import Options, Problem, Solution
from armsight_control.solvers.start import perturbed
from armsight_control.tracking import Moving, Target

# Descents that go on from one another for one target that does not move, before it is left at that.
_MOST_DESCENTS = 60
# The solver's branch is better than the present one where it is nearer to the point by this much.
_BETTER_M = 0.01


@dataclass(frozen=True, slots=True)
class Solved:
    """The newest solution and what it is for."""

    target: Target
    solution: Solution


class Pointing:
    """From targets to aims; remembers the branch."""

    def __init__(self, options: Options, free: tuple[int, ...], seed: int, counters: Counters) -> None:
        """Nothing is aimed at yet."""
        self._options, self._free, self._counters = options, free, counters
        self._rng = np.random.default_rng(seed)
        self.forget()

    def forget(self) -> None:
        """Of another target or mode: the branch is chosen anew."""
        self.solution: Solution | None = None
        self._solved: Solved | None = None
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
        self._solved = Solved(target, solution)
        self.solution = solution

    def aim(self, chain: Chain, point: Moving, dt_s: float) -> tuple[Aim, bool] | None:
        """The configuration for a point, and whether it is on another branch than the last one.

        Nothing before the solver has chosen a branch.
        """
        solution = self.solution
        if solution is None:
            return None
        if self._aimed is None:
            self._aimed = solution.q
            first = aim(chain, self._free, point, self._aimed, dt_s)
            self._aimed = first.q
            return first, False
        found = aim(chain, self._free, point, self._aimed, dt_s)
        if not found.reachable:
            other = aim(chain, self._free, point, solution.q, dt_s)
            missed = float(np.linalg.norm(found.tip - point.position))
            if missed - float(np.linalg.norm(other.tip - point.position)) > _BETTER_M:
                found = other
        switched = bool(np.abs(found.q - self._aimed).max() > BRANCH_RAD)
        self._aimed = found.q
        if switched:
            self._counters.add("branch_switch")
        return found, switched
