"""Whether frames may go by shared memory here, and why not: what Zenoh needs of the machine.

Zenoh makes segments in /dev/shm and locks them. Where it can't, it opens no session at all, without a word of what to
do, or prints an error and copies: this is found out before.
"""

import os
import resource
from pathlib import Path
from typing import Literal

Use = Literal["off", "read", "publish"]
"""``publish`` makes a pool: who has the cameras, alone."""

# Three pairs of 800x800 rgb8 frames do not fit, three frames do: every process that maps the pool must lock it, and the
# usual limit is 8 MiB.
POOL_BYTES = 6 * 1024 * 1024
LOCK_BYTES = POOL_BYTES + 3 * 512 * 1024
"""Of memory that each process on the way of the frames must be allowed to lock."""
SESSION_BYTES = 1024 * 1024
"""Room in /dev/shm for what each session keeps there, with some to spare: it takes a third of that."""

PLACE = Path("/dev/shm")  # noqa: S108  (not a temporary file: the place itself)

_CAP_IPC_LOCK = 14


def why_not(use: Use) -> str:
    """What is in the way of shared memory, and what to do; empty where nothing is, or none is wanted."""
    if use == "off":
        return ""
    if not may_lock(LOCK_BYTES):
        return f"this process may lock less than {LOCK_BYTES} bytes; raise `ulimit -l` to use it"
    free = free_bytes()
    needed = SESSION_BYTES + (POOL_BYTES if use == "publish" else 0)
    if free is None:
        return f"there is no {PLACE}, or this user can't write there"
    if free < needed:
        return f"{PLACE} has {free} bytes free and {needed} are needed; in a container raise --shm-size"
    return ""


def may_lock(size: int) -> bool:
    """Whether this process may lock so many bytes of memory."""
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    return soft == resource.RLIM_INFINITY or soft >= size or _has_capability(_CAP_IPC_LOCK)


def free_bytes() -> int | None:
    """Room in /dev/shm; nothing where there is none, or this user can't write there."""
    try:
        told = os.statvfs(PLACE)
    except OSError:
        return None
    return told.f_bavail * told.f_frsize if os.access(PLACE, os.W_OK | os.X_OK) else None


def _has_capability(number: int) -> bool:
    status = Path("/proc/self/status").read_text(encoding="ascii")
    effective = next((line.split()[1] for line in status.splitlines() if line.startswith("CapEff:")), "0")
    return bool(int(effective, 16) >> number & 1)
