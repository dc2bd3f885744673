"""The cameras' pictures drawn side by side, by processes of their own.

Software OpenGL has one rasteriser in a process. Its threads wait for one another, and the second picture for the first:
two processes of one thread each draw a pair in two thirds of the time that one of two threads takes.
"""

import logging
import mmap
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from time import monotonic

import mujoco
import numpy as np
import numpy.typing as npt

from armsight.counters import Counters
from armsight_sim.cameras import Commission, Image
from armsight_sim.errors import RenderError

log = logging.getLogger(__name__)

State = npt.NDArray[np.float64]
"""Numbers as :data:`STATE` has them, and the brightness of the ambient light."""

# What a picture depends on beside the model; everything else follows by kinematics.
STATE = mujoco.mjtState.mjSTATE_QPOS | mujoco.mjtState.mjSTATE_MOCAP_POS | mujoco.mjtState.mjSTATE_MOCAP_QUAT

# The largest pictures take some 0.1 s, on a busy machine several times as long; what takes longer hangs.
_LONGEST_DRAWING_S = 5.0
_LONGEST_START_S = 30.0
_LOOK_S = 0.1
_THREADS = "LP_NUM_THREADS"


def bytes_of(wanted: Commission) -> int:
    """Of all pictures."""
    return sum(columns * rows * 3 for columns, rows in wanted.sizes)


def pictures_in(memory: mmap.mmap, wanted: Commission) -> list[Image]:
    """The pictures, one behind the other in a memory that two processes have."""
    found, start = [], 0
    for columns, rows in wanted.sizes:
        size = columns * rows * 3
        found.append(np.frombuffer(memory, np.uint8, size, start).reshape(rows, columns, 3))
        start += size
    return found


class Painters:
    """As :class:`~armsight_sim.cameras.Cameras`; a painter that dies is replaced. Use from one thread; close it."""

    def __init__(self, wanted: Commission, painters: int, counters: Counters, stop: threading.Event) -> None:
        """Starts the processes, which share the cameras among them.

        Args:
            wanted: of all of them together.
            painters: how many; no more than there are cameras are started.
            counters: take the painters that had to be replaced.
            stop: once set, nobody is waited for.

        Raises:
            RenderError: they don't draw, or are not to.
        """
        self._model, self._counters, self._stop = wanted.model, counters, stop
        self._state: State = np.empty(mujoco.mj_stateSize(wanted.model, STATE) + 1)
        self.light(float(wanted.model.vis.headlight.ambient[0]))
        names, count = wanted.names, min(painters, len(wanted.names))
        self._painters = [_Painter(replace(wanted, names=names[first::count]), count) for first in range(count)]
        # by camera: drawn by whom, and which of its pictures
        self._places = [(i % count, i // count) for i in range(len(names))]
        try:
            for painter in self._painters:
                painter.wait(_LONGEST_START_S, stop)
        except _LostError as error:
            self.close()
            raise RenderError(f"a process that draws did not start: {error}") from error

    def light(self, ambient: float) -> None:
        """Sets the brightness of the ambient light, 0 to 1."""
        self._state[-1] = ambient

    def draw(self, data: mujoco.MjData, into: Sequence[Image], meanwhile: Callable[[], None]) -> None:
        """As :meth:`Cameras.draw <armsight_sim.cameras.Cameras.draw>`, but that what is done meanwhile is beside.

        Raises:
            RenderError: a picture could not be painted, by a second painter either, or is not to be.
        """
        mujoco.mj_getState(self._model, data, self._state[:-1], STATE)
        wanted = self._state.tobytes()
        for painter in self._painters:
            painter.ask(wanted)
        meanwhile()
        for number, painter in enumerate(self._painters):
            try:
                painter.wait(_LONGEST_DRAWING_S, self._stop)
            except _LostError as error:
                self._painters[number] = self._another(painter, error, wanted)
        for image, (number, place) in zip(into, self._places, strict=True):
            np.copyto(image, self._painters[number].pictures[place])

    def close(self) -> None:
        """Ends the processes."""
        for painter in self._painters:
            painter.close()

    def _another(self, lost: "_Painter", error: Exception, wanted: bytes) -> "_Painter":
        if self._stop.is_set():
            raise RenderError("asked to stop") from error
        self._counters.add("painters_replaced")
        log.warning("a process that draws was lost, starting another", extra={"reason": str(error)})
        lost.close()
        painter = _Painter(lost.commission, len(self._painters))
        try:
            painter.wait(_LONGEST_START_S, self._stop)
            painter.ask(wanted)
            painter.wait(_LONGEST_DRAWING_S, self._stop)
        except _LostError as again:
            painter.close()
            raise RenderError(f"a process that draws was lost twice: {again}") from again
        return painter


class _LostError(Exception):
    """A painter that does not answer any more."""


class _Painter:
    """One process, and the memory that it paints into."""

    def __init__(self, commission: Commission, painters: int) -> None:
        """Starts it; it is there once :meth:`wait` returns."""
        self.commission = commission
        descriptor = os.memfd_create("armsight-pictures")
        self._connection, theirs = Pipe()
        try:
            size = bytes_of(commission)
            os.ftruncate(descriptor, size)
            self.pictures = pictures_in(mmap.mmap(descriptor, size), commission)
            self._process = _start(theirs, descriptor, painters)
        finally:
            os.close(descriptor)
            theirs.close()
        with suppress(OSError):  # told by wait()
            self._connection.send(commission)

    def ask(self, wanted: bytes) -> None:
        """Has the pictures painted; that they can't be is told by :meth:`wait`."""
        with suppress(OSError):
            self._connection.send_bytes(wanted)

    def wait(self, longest_s: float, stop: threading.Event) -> None:
        """Until what was asked for last is done.

        Raises:
            _LostError: it never will be.
        """
        until = monotonic() + longest_s
        try:
            while not self._connection.poll(_LOOK_S):
                if stop.is_set():
                    raise _LostError("it is to stop")
                if monotonic() > until:
                    raise _LostError(f"no picture for {longest_s:g} s")
            trouble = self._connection.recv_bytes()
        except (EOFError, OSError) as error:
            self._process.wait()
            raise _LostError(f"it ended with {self._process.returncode}") from error
        if trouble:
            raise _LostError(trouble.decode())

    def close(self) -> None:
        """Ends it."""
        self._connection.close()
        self._process.kill()  # it may be anywhere
        self._process.wait()


def _start(theirs: Connection, memory: int, painters: int) -> "subprocess.Popen[bytes]":
    threads = len(os.sched_getaffinity(0)) // painters
    return subprocess.Popen(
        [sys.executable, "-m", "armsight_sim.painter", str(theirs.fileno()), str(memory)],
        pass_fds=[theirs.fileno(), memory],
        stdin=subprocess.DEVNULL,
        # one thread beside that which asks for the picture only waits for it
        env={_THREADS: str(threads if threads > 1 else 0), **os.environ},
        start_new_session=True,  # Ctrl-C in a terminal is for the simulation, which ends this process
    )
