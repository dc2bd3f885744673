"""The stack: the router and the services, each a process, on one endpoint."""

import signal
import socket
import tempfile
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Self

from armsight.session import DEFAULT_NAMESPACE
from armsight.topics import SERVICES
from armsight_operator.certs.layout import CONFIGURATION
from armsight_operator.errors import OperatorError, PortInUseError
from armsight_operator.stack.executables import find_executable
from armsight_operator.stack.process import Process

NAMES = ("router", *SERVICES)

PAGE = "page"
"""Runs beside them where it is asked for."""

STOP_TIMEOUT_S = 2.0
"""A process that is not gone this long after SIGTERM is killed."""

_HOST = "127.0.0.1"


class Stack:
    """Starts and stops the processes; nothing is started before it is asked for.

    Args:
        clock: sim's, ``realtime`` or ``lockstep``.
        samples: sim's samples a pixel, 0 or 4.
        fps: sim's frames a second.
        start_time: sim's, RFC 3339, for runs that must repeat.
        target: what sim publishes on `target`: ``none``, ``default``, ``exercise``, ``visible``.
        mode: control's first mode.
        model: sim's, an MJCF or URDF (default: the arm that sim ships).
        calibration: sim's, a file of cameras and colours (default: the model's).
        out: folder for the logs (default: a new temporary one, left to whoever wants to read them).
        port: of the router on the loopback interface; 0 takes a free one.
        namespace: the robot's name on the bus.
        page_port: of the web page on the loopback interface; 0 takes a free one (default: there is no page).
        certificates: folder that `armsight certs make` made: everything goes over mutual TLS, each with its own rights
            (default: plain TCP, without rights).
        extra: further flags by service.
    """

    def __init__(
        self,
        *,
        clock: str = "realtime",
        samples: int = 0,
        fps: float = 30,
        start_time: str | None = None,
        target: str = "default",
        mode: str = "track",
        model: Path | None = None,
        calibration: Path | None = None,
        out: Path | None = None,
        port: int = 0,
        namespace: str = DEFAULT_NAMESPACE,
        page_port: int | None = None,
        certificates: Path | None = None,
        extra: Mapping[str, Sequence[str]] | None = None,
    ) -> None:
        """Chooses the port and makes the folder."""
        self.port = port or free_port()
        self.namespace = namespace
        self.page_port = page_port if page_port != 0 else free_port()
        self.names = NAMES if page_port is None else (*NAMES, PAGE)
        """Of all processes, in the order in which they are started."""
        self._certificates = certificates
        out = Path(tempfile.mkdtemp(prefix="armsight-")) if out is None else out
        self.log_folder = out / "logs"
        self._arguments = {
            "router": ["router", "--listen", self.endpoint],
            "sim": [
                *("--clock", clock, "--samples", str(samples), "--fps", f"{fps:g}", "--target", target),
                *(("--start-time", start_time) if start_time is not None else ()),
                *(("--model", str(model)) if model is not None else ()),
                *(("--calibration", str(calibration)) if calibration is not None else ()),
            ],
            "vision": [],
            "control": ["--mode", mode],
            PAGE: ["page", "--port", str(self.page_port)],
        }
        for name, flags in (extra or {}).items():
            self._arguments[self._known(name)] += flags
        for name in self.names[1:]:
            self._arguments[name] += ["--connect", self.endpoint, "--namespace", namespace]
        for name in self.names:
            if file := self.zenoh_config("operator" if name == PAGE else name):
                self._arguments[name] += ["--zenoh-config", str(file)]
        self._processes: dict[str, Process] = {}
        # Processes die with the thread that started them: this one ends in close().
        self._starter = ThreadPoolExecutor(max_workers=1, thread_name_prefix="stack")
        try:
            self.log_folder.mkdir(parents=True, exist_ok=True)
            for name in self.names:
                self.log_file(name).write_bytes(b"")
        except OSError as error:
            raise OperatorError(f"can't write logs to {self.log_folder}: {error.strerror}") from error

    @property
    def endpoint(self) -> str:
        """Where the router listens, for ``--connect``."""
        return f"{'tcp' if self._certificates is None else 'tls'}/{_HOST}:{self.port}"

    def zenoh_config(self, bearer: str) -> Path | None:
        """The Zenoh configuration of whoever has a certificate; none where the stack needs none.

        Raises:
            OperatorError: there is none by this name.
        """
        if self._certificates is None:
            return None
        file = self._certificates.absolute() / bearer / CONFIGURATION
        if not file.is_file():
            raise OperatorError(f"no certificate of {bearer} in {self._certificates}: `armsight certs make` makes it")
        return file

    def log_file(self, name: str) -> Path:
        """Everything that a process wrote, over all of its lives."""
        return self.log_folder / f"{self._known(name)}.log"

    def command(self, name: str) -> list[str]:
        """The command line of a process.

        Raises:
            MissingExecutableError: it is not installed.
        """
        return [str(find_executable(self._known(name))), *self._arguments[name]]

    def start(self, name: str) -> None:
        """Starts a process and returns at once; one that runs is left alone.

        Raises:
            MissingExecutableError: it is not installed.
            PortInUseError: somebody else listens on the router's port, or on the page's.
        """
        if self.running(name):
            return
        command = self.command(name)
        if name == "router":
            check_port_free(self.port)
        elif name == PAGE and self.page_port is not None:
            check_port_free(self.page_port, "the page's port", "does another one run? Choose another --page-port")
        try:
            self._processes[name] = self._starter.submit(Process, command, self.log_file(name)).result()
        except OSError as error:
            raise OperatorError(f"can't start {name}, {command[0]}: {error.strerror}") from error

    def start_all(self) -> None:
        """Starts the router, every service and the page; what is missing is said before anything runs."""
        for name in self.names:
            self.command(name)
        for name in self.names:
            self.start(name)

    def running(self, name: str) -> bool:
        """Whether a process was started and has not ended."""
        process = self._processes.get(self._known(name))
        return process is not None and process.poll() is None

    def process(self, name: str) -> Process | None:
        """The present or last life of a process."""
        return self._processes.get(self._known(name))

    def kill(self, name: str, number: int = signal.SIGKILL) -> None:
        """Sends a signal and waits until the process is gone, at most until it is killed for not ending."""
        process = self._processes.get(self._known(name))
        if process is None:
            raise OperatorError(f"{name} was never started")
        process.send(number)
        if not process.wait(STOP_TIMEOUT_S):
            process.kill()

    def stop(self, names: Sequence[str] = SERVICES, timeout_s: float = STOP_TIMEOUT_S) -> list[str]:
        """SIGTERM to all named, SIGKILL to those that take longer; returns the names of the latter."""
        deadline = time.monotonic() + timeout_s
        ending = {name: self._processes[name] for name in names if name in self._processes}
        for process in ending.values():
            process.send(signal.SIGTERM)
        late = [name for name, process in ending.items() if not process.wait(deadline - time.monotonic())]
        for name in late:
            ending[name].kill()
        return late

    def close(self) -> None:
        """Ends everything: the services, then the router they still talk over. Never takes longer than two timeouts."""
        self.stop(self.names[1:], timeout_s=0.75 * STOP_TIMEOUT_S)
        self.stop(("router",), timeout_s=0.2 * STOP_TIMEOUT_S)
        self._starter.shutdown()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _known(self, name: str) -> str:
        if name not in self.names:
            raise OperatorError(f"no process {name!r}; there are {', '.join(self.names)}")
        return name


def free_port() -> int:
    """A port of the loopback interface that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind((_HOST, 0))
        return int(probe.getsockname()[1])


def check_port_free(
    port: int,
    what: str = "port",
    then: str = "does another `armsight up` or router run? Stop it, or choose another port with --port",
) -> None:
    """Whether a server of ours can listen there.

    Args:
        port: of the loopback interface.
        what: what it is called in the error.
        then: what to do about it.

    Raises:
        PortInUseError: it can't, and what to do.
    """
    with socket.socket() as probe:
        # As the router does it: what is left of closed connections is not in the way.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((_HOST, port))
        except OSError as error:
            raise PortInUseError(f"{what} {port} can't be used ({error.strerror}): {then}") from error
