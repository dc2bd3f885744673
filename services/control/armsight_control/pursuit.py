"""Keeps the solver at what `track` and `follow` want: one solve at a time, always for the newest target."""

import threading
from collections import deque
from concurrent.futures import Future, wait
from time import monotonic, sleep

import numpy as np

from armsight.times import from_timestamp
from armsight.v1.control_pb2 import CONTROL_MODE_TRACK
from armsight.v1.joints_pb2 import JointPositions
from armsight_control.errors import ControlError
from armsight_control.loop import Loop
from armsight_control.modes import AIMING
from armsight_control.solvers import Solution
from armsight_control.solvers.process import Solvers, Timed
from armsight_control.tracking import Target

# In lockstep an answer waits this long for its solution: less than the 6 s after which sim asks again.
_MOST_WAIT_S = 4.0
# And this long for the target of the same instant, where they come with the frames.
_TARGET_WAIT_S = 0.5
_LOOK_S = 0.05


class Pursuit:
    """The loop's solver; called by the thread that answers positions."""

    def __init__(self, loop: Loop, lock: threading.Lock, solver: str) -> None:
        """Starts loading what the solver needs."""
        self.solvers = Solvers()
        self._loop = loop
        self._lock = lock
        self.solve_with(solver)
        self._job: tuple[Target, Future[Timed[Solution]]] | None = None
        self.refusal = ""
        """Why the solver had no solution for the last target; empty where it had one."""
        self._seconds: deque[float] = deque(maxlen=100)
        self._previous_capture_ns = 0

    def solve_with(self, solver: str) -> None:
        """Takes a solver for the next targets, and begins to load what it needs.

        Raises:
            SolverError: no solver of that name.
        """
        self.solvers.prepare(solver)
        self._solver, self.refusal = solver, ""

    def gauges(self) -> dict[str, float]:
        """Current values for health."""
        gauges = {"solver_restarts": float(self.solvers.restarts)}
        return gauges | ({"ik_ms": float(np.median(self._seconds)) * 1e3} if self._seconds else {})

    def go_on(self) -> None:
        """Takes a solution that is there and asks for the next; waits for nothing."""
        self._take()
        self._ask()

    def catch_up(self, positions: JointPositions, stop: threading.Event) -> None:
        """Waits for the solution of the present target, so that runs in lockstep repeat; bounded."""
        previous_ns, capture_ns = self._previous_capture_ns, from_timestamp(positions.capture_time)
        self._previous_capture_ns = capture_ns
        if capture_ns == previous_ns or self._loop.mode not in AIMING:
            return  # what was answered gets that answer again: the next instant's positions would grow old meanwhile
        until = monotonic() + _MOST_WAIT_S
        if self._loop.mode == CONTROL_MODE_TRACK:
            self._await_target(previous_ns, capture_ns)
        if self._job is not None and not self._finish(until, stop):
            return
        self._ask()
        self._finish(until, stop)

    def _ask(self) -> None:
        if self._job is not None:
            return
        with self._lock:
            wanted = self._loop.problem()
        if wanted is not None:
            target, problem = wanted
            self._job = target, self.solvers.submit(self._solver, problem)

    def _finish(self, until: float, stop: threading.Event) -> bool:
        while self._job is not None and not stop.is_set() and monotonic() < until:
            wait([self._job[1]], timeout=_LOOK_S)
            self._take()
        return self._job is None

    def _take(self) -> None:
        if self._job is None or not self._job[1].done():
            return
        target, future = self._job
        self._job = None
        try:
            solved = future.result()
        except ControlError as error:
            # asked again with the next positions: a process that died starts again, another solver may be chosen
            self.refusal = str(error)
            with self._lock:
                self._loop.unsolved(self.refusal)
            return
        self.refusal = ""
        self._seconds.append(solved.seconds)
        with self._lock:
            self._loop.solved(target, solved.solution)

    def _await_target(self, previous_ns: int, capture_ns: int) -> None:
        """Where targets come with the frames (sim's moving target), waits for the one of this instant."""
        with_frames = self._target_stamp_ns() in (previous_ns, capture_ns)
        until = monotonic() + _TARGET_WAIT_S
        while with_frames and self._target_stamp_ns() < capture_ns and monotonic() < until:
            sleep(0.001)

    def _target_stamp_ns(self) -> int:
        target = self._loop.target
        return 0 if target is None else target.stamp_ns
