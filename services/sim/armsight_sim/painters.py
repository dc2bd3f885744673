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
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from time import monotonic

import mujoco
import numpy as np
import numpy.typing as npt

from armsight.counters import Counters
from armsight_sim.cameras import Image, picture_size
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


@dataclass(frozen=True, slots=True)
class Commission:
    """What one painter draws, as :class:`~armsight_sim.cameras.Cameras` takes it."""

    model: mujoco.MjModel
    names: Sequence[str]
    width: int
    height: int
    samples: int
    emissive: bool
    groups: Sequence[int]

    @property
    def shapes(self) -> list[tuple[int, int, int]]:
        """Of the pictures in the order of the names: rows, columns, 3."""
        sizes = [picture_size(self.model, name, self.width, self.height) for name in self.names]
        return [(height, width, 3) for width, height in sizes]

    @property
    def size(self) -> int:
        """Bytes of all pictures."""
        return sum(rows * columns * channels for rows, columns, channels in self.shapes)


def pictures_in(memory: mmap.mmap, shapes: Sequence[tuple[int, int, int]]) -> list[Image]:
    """Pictures one behind the other in a memory that two processes have."""
    found, start = [], 0
    for shape in shapes:
        size = int(np.prod(shape))
        found.append(np.frombuffer(memory, np.uint8, size, start).reshape(shape))
        start += size
    return found


class Painters:
    """As :class:`~armsight_sim.cameras.Cameras`; a painter that dies is replaced. Use from one thread; close it."""

    def __init__(
        self,
        model: mujoco.MjModel,
        names: Sequence[str],
        width: int,
        height: int,
        samples: int,
        *,
        painters: int,
        counters: Counters,
        stop: threading.Event,
        emissive: bool = False,
        groups: Sequence[int] = (),
    ) -> None:
        """Starts the processes, which share the cameras among them.

        Args:
            model: left as it is.
            names: see :class:`~armsight_sim.cameras.Cameras`, as all that is not said here.
            width: as there.
            height: as there.
            samples: as there.
            painters: how many; no more than there are cameras are started.
            counters: take the painters that had to be replaced.
            stop: once set, nobody is waited for.
            emissive: as there.
            groups: as there.

        Raises:
            RenderError: they don't draw, or are not to.
        """
        self._model, self._counters, self._stop = model, counters, stop
        self._state: State = np.empty(mujoco.mj_stateSize(model, STATE) + 1)
        self.light(float(model.vis.headlight.ambient[0]))
        count = min(painters, len(names))
        self._painters = [
            _Painter(Commission(model, names[first::count], width, height, samples, emissive, groups), count)
            for first in range(count)
        ]
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

    def draw(
        self,
        data: mujoco.MjData,
        into: Sequence[Image] | None = None,
        meanwhile: Callable[[], None] = lambda: None,
    ) -> list[Image]:
        """One rgb8 image for each camera, the top row first.

        Args:
            data: of the model.
            into: images to copy the pictures to (default: what is returned is painted over the next time).
            meanwhile: what is to be done while they are painted; once.

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
        painted = [self._painters[painter].pictures[place] for painter, place in self._places]
        if into is None:
            return painted
        for place, picture in zip(into, painted, strict=True):
            np.copyto(place, picture)
        return list(into)

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
            os.ftruncate(descriptor, commission.size)
            self.pictures = pictures_in(mmap.mmap(descriptor, commission.size), commission.shapes)
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
