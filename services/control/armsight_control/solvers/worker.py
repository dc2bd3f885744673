"""The process that solves beside the loop: `python -m armsight_control.solvers.worker FD`.

Loading torch takes seconds and holds the interpreter's lock; here it is in nobody's way. Requests and replies are
pickled over a pipe that no other process has.
"""

import ctypes
import os
import signal
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection
from time import perf_counter

from armsight_control.errors import ControlError
from armsight_control.solvers import solve, solve_batch

_PR_SET_PDEATHSIG = 1
_FUNCTIONS: dict[str, Callable[..., object]] = {"solve": solve, "solve_batch": solve_batch}


def main(descriptor: int, parent: int) -> None:
    """Loads torch, says so, and solves until the pipe ends."""
    # not only at the pipe's end: that would be seen after torch is loaded
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        return
    os.nice(5)  # the loop comes first
    connection: Connection = Connection(descriptor)
    try:
        import torch

        from armsight_control.solvers.packages import prepare

        torch.set_num_threads(1)
        backends, note = prepare()
        connection.send(("ready", (f"torch {torch.__version__}, {backends}", note)))
    except Exception as error:
        connection.send(("broken", f"torch can't be loaded: {error}"))
        return
    while True:
        try:
            function, arguments = connection.recv()
        except EOFError:
            return
        began = perf_counter()
        try:
            solution = _FUNCTIONS[function](*arguments)
        except ControlError as error:
            connection.send(("refused", str(error)))
        else:
            connection.send(("solved", (solution, perf_counter() - began)))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
