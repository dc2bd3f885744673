"""What every solver takes and returns."""

from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from armsight_control.chain import Array, Chain
from armsight_control.folded import Folded
from armsight_control.solvers.options import Options


class Status(Enum):
    """How a solve ended."""

    CONVERGED = "converged"
    STEP_LIMIT = "step limit"
    """Ran out of steps above the tolerance."""
    UNREACHABLE = "unreachable"
    """No configuration reaches the target: the solution is for the nearest point that one does."""


REPORT_FREE = (0, 2, 3)
"""The report's inverse kinematics: joint 2 stays where it is, at 0."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One target for the tip."""

    chain: Chain
    target: Array
    """(3,), base frame, metres."""
    start: Array
    """(n,), all joints, radians; always inside the limits once solved."""
    free: tuple[int, ...]
    """Indices of the joints that may move; the others stay at the start's values."""
    options: Options = field(default_factory=Options)


@dataclass(frozen=True, slots=True)
class Solution:
    """Where a solver went."""

    q: Array
    """All joints, radians, inside the limits."""
    tip: Array
    """Of that configuration, base frame."""
    residual_m: float
    """Euclidean distance of tip and target."""
    iterations: int
    status: Status
    converged: bool
    """Whether the tip is where the solver meant to put it: at the target, or at the reachable point nearest to it."""
    note: str = ""
    """What the solver had to do without, one line for a person; empty where all was as it should be."""


@dataclass(frozen=True, slots=True)
class Solutions:
    """Solutions of m targets, as arrays; fields as in :class:`Solution`."""

    q: Array
    """(m, n)."""
    tip: Array
    """(m, 3)."""
    residual_m: Array
    """(m,)."""
    iterations: NDArray[np.int64]
    """(m,)."""
    status: tuple[Status, ...]
    converged: NDArray[np.bool_]
    """(m,)."""
    note: str = ""

    def __len__(self) -> int:
        return len(self.q)

    def __getitem__(self, index: int) -> Solution:
        return Solution(
            q=self.q[index],
            tip=self.tip[index],
            residual_m=float(self.residual_m[index]),
            iterations=int(self.iterations[index]),
            status=self.status[index],
            converged=bool(self.converged[index]),
            note=self.note,
        )


@dataclass(frozen=True, slots=True)
class Task:
    """What a solver gets: m targets of one chain with the same joints held at the same angles."""

    chain: Chain
    folded: Folded
    aims: Array
    """(m, 3), base frame: the targets, moved to the nearest reachable points where these are known."""
    starts: Array
    """(m, n), all joints, inside the limits."""
    options: Options

    @property
    def free_starts(self) -> Array:
        """(m, k), of the free joints."""
        return self.starts[:, self.folded.free]


@dataclass(frozen=True, slots=True)
class Found:
    """What a solver gives back for a task."""

    q: Array
    """(m, k), of the free joints."""
    iterations: NDArray[np.int64]
    """(m,)."""
    met: NDArray[np.bool_]
    """(m,): the tip is at the aim."""
    stationary: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    """(m,): it is not, and within the limits no motion brings it nearer. Empty where the solver doesn't look."""
    note: str = ""
