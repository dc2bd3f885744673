"""Checks of the machine: memory, disk, clock, ports, Docker. Pure: facts in, finding out."""

from collections.abc import Mapping
from dataclasses import dataclass

from armsight_operator.doctor.finding import Finding, broken, info, ok, warning

MB = 1_000_000
GB = 1_000_000_000

_LEAST_DISK, _ENOUGH_DISK = 100 * MB, 1 * GB
_JUMP_S = 0.05
"""Two clocks that tell of the same short wait differ by less, however busy the machine is."""


def memory_lock(may: bool, limit_bytes: int | None, needed_bytes: int) -> Finding:
    """Whether frames can go by shared memory: each process on their way locks the pool. No limit is None."""
    limit = "no limit" if limit_bytes is None else f"limit {limit_bytes / MB:.1f} MB"
    if may:
        return ok("memory lock", f"{limit}, {needed_bytes / MB:.1f} MB are needed for shared memory")
    mend = f"raise it with `ulimit -l {needed_bytes // 1024 + 1}` (Docker: --ulimit memlock), or let frames go by TCP"
    return warning("memory lock", f"{limit}, {needed_bytes / MB:.1f} MB are needed for shared memory", mend)


def shared_memory(free_bytes: int | None, pool_bytes: int) -> Finding:
    """Whether the pool fits into /dev/shm; nothing where there is no such place."""
    if free_bytes is None:
        mend = "mount a tmpfs there (Docker: --shm-size), or set ARMSIGHT_SHARED_MEMORY=off: frames then go by TCP"
        return warning("shared memory", "there is no /dev/shm", mend)
    found = f"{free_bytes / MB:.0f} MB free in /dev/shm, the pool takes {pool_bytes / MB:.1f} MB"
    if free_bytes < pool_bytes:
        return broken("shared memory", found, "remove what is left over there, or enlarge it (Docker: --shm-size)")
    return ok("shared memory", found)


def disk(free_bytes: int, folder: str) -> Finding:
    """Whether logs, pictures and recordings have a place."""
    found = f"{free_bytes / GB:.1f} GB free in {folder}"
    if free_bytes < _LEAST_DISK:
        return broken("disk", found, "make room: logs and pictures can't be written")
    if free_bytes < _ENOUGH_DISK:
        return warning("disk", found, "make room, or write elsewhere with `armsight up --out`")
    return ok("disk", found)


@dataclass(frozen=True, slots=True)
class ClockFacts:
    """How this machine's clocks behaved during a short wait."""

    wall_s: float
    """Unix time."""
    newest_file_s: float
    """Unix time at which armsight was installed."""
    wall_took_s: float
    monotonic_took_s: float
    synchronised: bool | None
    """By the kernel's word; None where it gives none."""


def clock(facts: ClockFacts) -> Finding:
    """Whether wall-clock times can be believed: certificates, stage times and recordings are made with them."""
    if facts.wall_s < facts.newest_file_s - 86400:
        return broken("clock", "the wall clock is behind the day on which armsight was installed", "set the clock")
    jump_s = facts.wall_took_s - facts.monotonic_took_s
    if abs(jump_s) > _JUMP_S:
        mend = "let one program alone set the clock, and slew it: latencies of frames are wrong meanwhile"
        return warning("clock", f"the wall clock jumped by {jump_s:+.2f} s while looked at", mend)
    if facts.synchronised is None:
        return ok("clock", "runs evenly; whether it is synchronised can't be told here")
    if not facts.synchronised:
        mend = "with services on several machines start chrony or systemd-timesyncd; on one machine it doesn't matter"
        return warning("clock", "runs evenly, but is not synchronised with others", mend)
    return ok("clock", "runs evenly and is synchronised")


@dataclass(frozen=True, slots=True)
class Holder:
    """Who listens at a port."""

    pid: int | None
    """Nothing where it is another user's."""
    command: str = ""


def port(number: int, use: str, option: str, holder: Holder | None, *, ours: bool) -> Finding:
    """Whether a port of this machine can be had.

    Args:
        number: the port.
        use: what for.
        option: the flag that chooses another.
        holder: who listens there; None: nobody.
        ours: whether what listens is what should.
    """
    name = f"port {number}"
    if holder is None:
        return ok(name, f"free, for {use}")
    who = holder.command or "a process of another user"
    pid = "" if holder.pid is None else f" (pid {holder.pid})"
    if ours:
        return ok(name, f"held by {who}{pid}, which is {use}")
    return warning(name, f"wanted for {use}, held by {who}{pid}", f"end that, or choose another with {option}")


def docker(version: str, reason: str) -> Finding:
    """Whether there is a Docker daemon; nothing needs one but the containers."""
    if version:
        return ok("docker", f"daemon {version}")
    return info("docker", f"none: {reason}", "only `docker compose` needs it")


def holder_of(number: int, listening: Mapping[int, int], owners: Mapping[int, Holder]) -> Holder | None:
    """Who listens at a port.

    Args:
        number: the port.
        listening: the inode of each listening socket, by its port.
        owners: processes by the inodes of their sockets, as far as this user may see them.
    """
    inode = listening.get(number)
    return None if inode is None else owners.get(inode, Holder(None))


def listening_ports(table: str) -> dict[int, int]:
    """Inodes of listening sockets by port, of the text of /proc/net/tcp or tcp6."""
    rows = (line.split() for line in table.splitlines()[1:])
    return {int(row[1].rpartition(":")[2], 16): int(row[9]) for row in rows if len(row) > 9 and row[3] == "0A"}
