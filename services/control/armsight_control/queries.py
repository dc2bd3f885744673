"""The queryables of control: `control/mode`, `control/forward_kinematics`, `control/solve_ik`."""

import threading
from concurrent.futures import TimeoutError as FutureTimeoutError

import numpy as np

from armsight.v1.control_pb2 import (
    IK_STATUS_CONVERGED,
    IK_STATUS_OUT_OF_REACH,
    IK_STATUS_STEP_LIMIT,
    ForwardKinematicsRequest,
    ForwardKinematicsResponse,
    IkStatus,
    SetModeRequest,
    SetModeResponse,
    SolveIkRequest,
    SolveIkResponse,
)
from armsight.v1.geometry_pb2 import Vector3
from armsight.v1.joints_pb2 import JointSetpoint
from armsight_control.chain import Array, Chain
from armsight_control.errors import ModeError, SolverError
from armsight_control.kinematics import forward, jacobian
from armsight_control.loop import Loop
from armsight_control.modes import configuration_of, mode_of
from armsight_control.settings import Settings
from armsight_control.solvers import Problem, Status
from armsight_control.solvers.process import Solvers
from armsight_control.solvers.start import start, with_joint2_at_0
from armsight_control.tracking import finite_target

# Less than the 5 s that callers wait by default: they get our reason instead of silence.
_PATIENCE_S = 4.0

_STATUS: dict[Status, IkStatus] = {
    Status.CONVERGED: IK_STATUS_CONVERGED,
    Status.STEP_LIMIT: IK_STATUS_STEP_LIMIT,
    Status.UNREACHABLE: IK_STATUS_OUT_OF_REACH,
}


class Queries:
    """Answers requests; each from a thread of its own."""

    def __init__(self, loop: Loop, lock: threading.Lock, solvers: Solvers, settings: Settings) -> None:
        """Shares loop and solvers with the thread that answers positions."""
        self._loop = loop
        self._lock = lock
        self._solvers = solvers
        self._settings = settings
        self._rng = np.random.default_rng(settings.seed)
        self._previous: Array | None = None

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
        return ForwardKinematicsResponse(tip=_vector(forward(chain, q)), jacobian=jacobian(chain, q).ravel().tolist())

    def solve_ik(self, request: SolveIkRequest) -> SolveIkResponse:
        """Solves for one target."""
        chain = self._chain()
        if not request.HasField("target"):
            raise SolverError("no target: expected a point in the base frame, metres")
        target = finite_target(request.target.x, request.target.y, request.target.z)
        if request.start:
            begin = with_joint2_at_0(chain, configuration_of(request.start, chain))
        else:
            begin = start(chain, self._settings.initialisation, self._previous, self._rng)
        name = request.solver or self._settings.solver
        future = self._solvers.submit(name, Problem(chain, target, begin, self._settings.ik))
        try:
            solved = future.result(timeout=_PATIENCE_S)
        except FutureTimeoutError:
            future.cancel()
            state = self._solvers.trouble or ("solver loading" if self._solvers.loading else "the solver is busy")
            raise SolverError(f"no solution within {_PATIENCE_S:g} s: {state}; ask again") from None
        solution = solved.solution
        self._previous = solution.q
        return SolveIkResponse(
            status=_STATUS[solution.status],
            joints=[
                JointSetpoint(name=joint, position_rad=angle)
                for joint, angle in zip(chain.names, solution.q, strict=True)
            ],
            tip=_vector(solution.tip),
            residual_m=solution.residual_m,
            iterations=solution.iterations,
            solve_ms=solved.seconds * 1e3,
        )

    def _chain(self) -> Chain:
        arm = self._loop.arm
        if arm is None:
            raise ModeError("the arm's description has not arrived yet: is sim running?")
        return arm.chain


def _vector(values: Array) -> Vector3:
    return Vector3(x=values[0], y=values[1], z=values[2])
