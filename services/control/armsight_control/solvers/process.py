"""Solving beside the loop: keeps a process for the solvers that need torch, and starts it again when it dies."""

import logging
import os
import queue
import subprocess
import sys
import threading
from concurrent.futures import Future
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from time import monotonic, perf_counter
from typing import Any, Generic, Literal, TypeVar

from armsight_control.chain import Array, Chain
from armsight_control.errors import ControlError, SolverError
from armsight_control.solvers import (
    Options,
    Problem,
    Solution,
    Solutions,
    beside_the_loop,
    check_solver,
    solve,
)

log = logging.getLogger(__name__)

# Looked at this often: whether the process is still there, and whether to close.
_LOOK_S = 0.1
# A descent of the most steps takes some ten seconds; what takes longer hangs.
_LONGEST_SOLVE_S = 60.0
_RESTART_S = 1.0


S = TypeVar("S", Solution, Solutions)


@dataclass(frozen=True, slots=True)
class Timed(Generic[S]):
    """A solution, or those of a batch, and what it took."""

    solution: S
    seconds: float


@dataclass(frozen=True, slots=True)
class _Job:
    function: Literal["solve", "solve_batch"]
    arguments: tuple[Any, ...]
    future: "Future[Timed[Any]]"


class _LostError(Exception):
    """The process died."""


class Solvers:
    """Solves by name: at once where that takes microseconds, else in a process of its own, one job after the other."""

    def __init__(self) -> None:
        """Starts nothing yet."""
        self._jobs: queue.Queue[_Job] = queue.Queue()
        self._closing = threading.Event()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._ready = False
        self._trouble = ""
        self._note = ""
        self.restarts = 0

    @property
    def trouble(self) -> str:
        """What is wrong with the process, one line for health; empty where nothing is."""
        return self._trouble

    @property
    def note(self) -> str:
        """What the process does without, one line: the solvers work, but slower than they could."""
        return self._note

    @property
    def loading(self) -> bool:
        """Whether the process was started and is not ready yet."""
        return self._thread is not None and not self._ready

    def prepare(self, name: str) -> None:
        """Loads what a solver needs.

        Raises:
            SolverError: no solver of that name.
        """
        check_solver(name)
        if beside_the_loop(name):
            self._begin()

    def _begin(self) -> None:
        with self._lock:
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="solver", daemon=True)
                self._thread.start()

    def submit(self, name: str, problem: Problem) -> "Future[Timed[Solution]]":
        """Solves a problem; the future has the solution, or a :class:`SolverError`.

        Raises:
            SolverError: no solver of that name.
        """
        self.prepare(name)
        future: Future[Timed[Solution]] = Future()
        if beside_the_loop(name):
            self._jobs.put(_Job("solve", (name, problem), future))
            return future
        began = perf_counter()
        try:
            solution = solve(name, problem)
        except ControlError as error:
            future.set_exception(error)
        else:
            future.set_result(Timed(solution, perf_counter() - began))
        return future

    def submit_batch(
        self, name: str, chain: Chain, targets: Array, starts: Array, free: tuple[int, ...], options: Options
    ) -> "Future[Timed[Solutions]]":
        """Solves many targets, whatever the solver, beside the loop; arguments and result as of `solve_batch`.

        Raises:
            SolverError: no solver of that name.
        """
        check_solver(name)
        self._begin()
        future: Future[Timed[Solutions]] = Future()
        self._jobs.put(_Job("solve_batch", (name, chain, targets, starts, free, options), future))
        return future

    def close(self) -> None:
        """Ends the process."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join(timeout=2.0)

    def _run(self) -> None:
        while not self._closing.is_set():
            ours, theirs = Pipe()
            with ours:
                with theirs:
                    process = self._start(theirs)
                try:
                    self._serve(ours)
                except (EOFError, OSError, _LostError) as error:
                    self._trouble = self._trouble or f"the solver's process died ({error}), starting it again"
                    log.warning("%s", self._trouble)
                finally:
                    self._ready = False
                    process.kill()
                    process.wait()
            if not self._closing.wait(_RESTART_S):
                self.restarts += 1

    def _start(self, theirs: Connection) -> "subprocess.Popen[bytes]":
        descriptor = theirs.fileno()
        return subprocess.Popen(
            [sys.executable, "-m", "armsight_control.solvers.worker", str(descriptor), str(os.getpid())],
            pass_fds=[descriptor],
            stdin=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C in a terminal is for the service, which ends this process
        )

    def _serve(self, connection: Connection) -> None:
        kind, said = self._receive(connection, _LONGEST_SOLVE_S)
        if kind != "ready":
            self._trouble = str(said)
            raise _LostError(said)
        text, self._note = said
        log.info("solver ready", extra={"with": text})
        if self._note:
            log.warning("%s", self._note)
        self._ready, self._trouble = True, ""
        while not self._closing.is_set():
            try:
                job = self._jobs.get(timeout=_LOOK_S)
            except queue.Empty:
                if connection.poll():
                    raise EOFError("its pipe ended") from None
                continue
            if job.future.set_running_or_notify_cancel():
                self._do(job, connection)

    def _do(self, job: _Job, connection: Connection) -> None:
        try:
            connection.send((job.function, job.arguments))
            kind, result = self._receive(connection, _LONGEST_SOLVE_S)
        except (EOFError, OSError, _LostError) as error:
            job.future.set_exception(SolverError("the solver's process died over this target: ask again"))
            raise _LostError(error) from error
        if kind == "solved":
            solution, seconds = result
            job.future.set_result(Timed(solution, seconds))
        else:
            job.future.set_exception(SolverError(str(result)))

    def _receive(self, connection: Connection, longest_s: float) -> tuple[str, Any]:
        until = monotonic() + longest_s
        while not connection.poll(_LOOK_S):
            if self._closing.is_set():
                raise _LostError("closing")
            if monotonic() > until:
                raise _LostError(f"no answer for {longest_s:g} s")
        kind, result = connection.recv()
        return kind, result
