"""One process of the stack: its log goes to a file, and it never outlives us."""

import ctypes
import os
import signal
import subprocess
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

_PR_SET_PDEATHSIG = 1
_POLL_S = 0.01
_TAIL_BYTES = 4096

# Loaded before any fork: the child only calls it.
_LIBC = ctypes.CDLL(None, use_errno=True)


class Process:
    """A running command in a process group of its own, its own children included.

    The kernel kills it when the thread that started it ends: start it from one that lives as long as it should.
    """

    def __init__(self, command: Sequence[str], log_file: Path) -> None:
        """Starts the command; its output is appended to ``log_file``."""
        self.command = tuple(command)
        self.log_file = log_file
        self.started_s = time.monotonic()
        self._log_start = log_file.stat().st_size if log_file.exists() else 0
        parent = os.getpid()

        def die_with_parent() -> None:
            _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
            if os.getppid() != parent:  # it died before the kernel was told
                os._exit(1)

        with log_file.open("ab") as log:
            # A group of its own, so that Ctrl-C in the terminal reaches the stack alone, which passes it on in order.
            self._popen = subprocess.Popen(
                self.command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=die_with_parent,
            )

    @property
    def pid(self) -> int:
        """Its process id, and that of its group."""
        return self._popen.pid

    def poll(self) -> int | None:
        """Its exit code (negative: the signal that killed it), nothing while it runs.

        What is left of its group is killed before its id can be given to another.
        """
        if self._popen.returncode is None and self._ended():
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self.pid, signal.SIGKILL)
        return self._popen.poll()

    def send(self, number: int) -> None:
        """Sends a signal, if it still runs."""
        if self.poll() is None:
            self._popen.send_signal(number)

    def wait(self, timeout_s: float) -> bool:
        """Whether it is gone within the time."""
        deadline = time.monotonic() + timeout_s
        while self.poll() is None:
            if time.monotonic() >= deadline:
                return False
            time.sleep(_POLL_S)
        return True

    def kill(self) -> None:
        """SIGKILL to it and its children; returns when it is gone."""
        if self.poll() is None:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self.pid, signal.SIGKILL)
            while self.poll() is None:
                time.sleep(_POLL_S)

    def last_line(self) -> str:
        """The last line that it wrote in this life; empty if it wrote none."""
        with self.log_file.open("rb") as log:
            size = log.seek(0, os.SEEK_END)
            log.seek(max(self._log_start, size - _TAIL_BYTES))
            lines = log.read().decode(errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "")

    def _ended(self) -> bool:
        try:
            return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
        except ChildProcessError:
            return True
