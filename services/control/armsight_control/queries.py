"""The queryables of control: `control/mode`, `control/forward_kinematics`, `control/solve_ik`."""

import threading
from collections.abc import Sequence
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError

import numpy as np

from armsight.v1.control_pb2 import (
    IK_STATUS_CONVERGED,
    IK_STATUS_STEP_LIMIT,
    IK_STATUS_UNREACHABLE,
    ForwardKinematicsRequest,
    ForwardKinematicsResponse,
    IkSolution,
    IkStatus,
    SetModeRequest,
    SetModeResponse,
    SolveIkRequest,
    SolveIkResponse,
)
from armsight.v1.geometry_pb2 import Vector3
from armsight.v1.joints_pb2 import JointSetpoint
from armsight_control import own
from armsight_control.aiming import free_of
from armsight_control.chain import Array, Chain
from armsight_control.description import vector3
from armsight_control.errors import ModeError, SolverError
from armsight_control.kinematics import forward, jacobian
from armsight_control.loop import Loop
from armsight_control.modes import configuration_of, mode_of
from armsight_control.settings import Settings
from armsight_control.solvers import REPORT_FREE, Problem, Solution, Status, check_applies, check_solver
from armsight_control.solvers.process import S, Solvers, Timed
from armsight_control.solvers.start import for_free, start
from armsight_control.tracking import finite_target

# Less than the 5 s that callers wait by default: they get our reason instead of silence.
_PATIENCE_S = 4.0
# In one request: what every batched solver does in a fraction of that time, even uncompiled.
_MOST_TARGETS = 1000
# The report's descent, and a solver of a person's own, go one by one; the former takes up to 0.2 s for each.
_MOST_TARGETS_ONE_BY_ONE = 16

_STATUS: dict[Status, IkStatus] = {
    Status.CONVERGED: IK_STATUS_CONVERGED,
    Status.STEP_LIMIT: IK_STATUS_STEP_LIMIT,
    Status.UNREACHABLE: IK_STATUS_UNREACHABLE,
}


class Queries:
    """Answers requests; each from a thread of its own."""

    def __init__(self, loop: Loop, lock: threading.Lock, solvers: Solvers, settings: Settings) -> None:
        """Shares loop and solvers with the thread that answers positions; `settings` may be replaced meanwhile."""
        self._loop = loop
        self._lock = lock
        self._solvers = solvers
        self.settings = settings
        self._rng = np.random.default_rng(settings.seed)
        self._previous: Array | None = None
        self._own_solver = settings.solver if own.is_place(settings.solver) else ""

    def mode(self, request: SetModeRequest) -> SetModeResponse:
        """Sets the mode; an empty request only asks for it."""
        with self._lock:
            if request.ByteSize() > 0:
                arm = self._loop.arm
                self._loop.set_mode(mode_of(request, None if arm is None else arm.chain))
            return SetModeResponse(mode=self._loop.mode)

    def forward_kinematics(self, request: ForwardKinematicsRequest) -> ForwardKinematicsResponse:
        """Tip and Jacobian of a configuration."""
        chain = self._chain()
        q = configuration_of(request.joints, chain)
        return ForwardKinematicsResponse(tip=vector3(forward(chain, q)), jacobian=jacobian(chain, q).ravel().tolist())

    def solve_ik(self, request: SolveIkRequest) -> SolveIkResponse:
        """Solves for one target, or for many."""
        chain = self._chain()
        name = request.solver or self.settings.solver
        self._check_solver(name)
        check_applies(name, chain)
        free = _free_of(request.free, chain)
        if request.targets:
            if request.HasField("target"):
                raise SolverError("target and targets are both given: expected one of them")
            return self._solve_many(name, chain, _targets_of(request.targets, name), self._start(request, chain), free)
        if not request.HasField("target"):
            raise SolverError("no target: expected a point in the base frame, metres")
        target = finite_target(request.target.x, request.target.y, request.target.z)
        begin = self._start(request, chain)
        solved = self._await(self._solvers.submit(name, Problem(chain, target, begin, free, self.settings.ik)))
        solution = solved.solution
        self._previous = solution.q
        one = _answer(solution, chain)
        return SolveIkResponse(
            status=one.status,
            joints=one.joints,
            tip=one.tip,
            residual_m=one.residual_m,
            iterations=one.iterations,
            solve_ms=solved.seconds * 1e3,
            note=solution.note,
        )

    def _solve_many(
        self, name: str, chain: Chain, targets: Array, begin: Array, free: tuple[int, ...]
    ) -> SolveIkResponse:
        starts = np.tile(begin, (len(targets), 1))
        solved = self._await(self._solvers.submit_batch(name, chain, targets, starts, free, self.settings.ik))
        solutions = solved.solution
        return SolveIkResponse(
            solutions=[_answer(solutions[i], chain) for i in range(len(solutions))],
            solve_ms=solved.seconds * 1e3,
            note=solutions.note,
        )

    def _start(self, request: SolveIkRequest, chain: Chain) -> Array:
        if request.start:
            begin = configuration_of(request.start, chain)
            return begin if request.free else for_free(chain, begin, REPORT_FREE)
        return start(chain, self.settings.initialisation, self._previous, self._rng)

    def _await(self, future: "Future[Timed[S]]") -> "Timed[S]":
        try:
            return future.result(timeout=_PATIENCE_S)
        except FutureTimeoutError:
            future.cancel()
            state = self._solvers.trouble or ("solver loading" if self._solvers.loading else "the solver is busy")
            raise SolverError(f"no solution within {_PATIENCE_S:g} s: {state}; ask again") from None

    def _check_solver(self, name: str) -> None:
        """Of a person's own only the one that control was started with: nothing is imported for the bus."""
        if own.is_place(name) and name != self._own_solver:
            raise SolverError(f"{name!r} is not what control was started with: start it with --solver {name}")
        check_solver(name)

    def _chain(self) -> Chain:
        arm = self._loop.arm
        if arm is None:
            raise ModeError("the arm's description has not arrived yet: is sim running?")
        return arm.chain


def _free_of(names: Sequence[str], chain: Chain) -> tuple[int, ...]:
    if not names:
        return free_of(chain, "3")
    unknown = [name for name in names if name not in chain.names]
    if unknown or len(set(names)) < len(names):
        said = f"no joint {unknown[0]!r}" if unknown else "one of them twice"
        raise SolverError(f"free joints: {said}; this arm has {', '.join(chain.names)}")
    return tuple(sorted(chain.names.index(name) for name in names))


def _targets_of(points: Sequence[Vector3], name: str) -> Array:
    one_by_one = name == "gradient-descent" or own.is_place(name)
    most = _MOST_TARGETS_ONE_BY_ONE if one_by_one else _MOST_TARGETS
    if len(points) > most:
        raise SolverError(f"{len(points)} targets: {name} takes at most {most} in one request")
    targets = []
    for i, point in enumerate(points):
        try:
            targets.append(finite_target(point.x, point.y, point.z))
        except SolverError as error:
            raise SolverError(f"targets[{i}]: {error}") from error
    return np.array(targets)


def _answer(solution: Solution, chain: Chain) -> IkSolution:
    return IkSolution(
        status=_STATUS[solution.status],
        joints=[
            JointSetpoint(name=joint, position_rad=angle) for joint, angle in zip(chain.names, solution.q, strict=True)
        ],
        tip=vector3(solution.tip),
        residual_m=solution.residual_m,
        iterations=solution.iterations,
    )
