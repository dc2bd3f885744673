"""What Linux tells of running processes: their processor time and their memory."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

_TICK_S = 1 / os.sysconf("SC_CLK_TCK")
_PARENT, _USER, _SYSTEM = 1, 11, 12
"""Fields of /proc/PID/stat after the name, counted from 0."""


@dataclass(frozen=True, slots=True)
class Memory:
    """Of one process and those that it started, in MB (10⁶ bytes)."""

    rss_mb: float
    """Pages that it has mapped, shared ones in full."""
    pss_mb: float
    """Shared ones divided by the number of those that share them: this adds up over processes."""


def family(pid: int) -> list[int]:
    """A process and all that it started, and those that these started."""
    return sorted(_family([pid], _stats()))


def processor_s(pids: Iterable[int]) -> float:
    """Seconds of processor time that processes and those that they started have used; those that ended don't count."""
    stats = _stats()
    return sum((int(stats[pid][_USER]) + int(stats[pid][_SYSTEM])) * _TICK_S for pid in _family(pids, stats))


def memory(pid: int) -> Memory:
    """Of a process and all that it started."""
    kb = {"Rss": 0, "Pss": 0}
    for each in family(pid):
        try:
            text = Path(f"/proc/{each}/smaps_rollup").read_text(encoding="ascii")
        except OSError:  # it ended
            continue
        for line in text.splitlines():
            name = line.split(":")[0]
            if name in kb:
                kb[name] += int(line.split()[1])
    return Memory(rss_mb=kb["Rss"] * 1024 / 1e6, pss_mb=kb["Pss"] * 1024 / 1e6)


def _family(pids: Iterable[int], stats: Mapping[int, list[str]]) -> set[int]:
    found = {pid for pid in pids if pid in stats}
    while True:
        more = {pid for pid, stat in stats.items() if int(stat[_PARENT]) in found} - found
        if not more:
            return found
        found |= more


def _stats() -> dict[int, list[str]]:
    found = ((folder.name, _stat(folder / "stat")) for folder in Path("/proc").iterdir() if folder.name.isdigit())
    return {int(name): stat for name, stat in found if stat is not None}


def _stat(file: Path) -> list[str] | None:
    """Fields after the name, which may hold anything; none once the process has ended."""
    try:
        return file.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    except OSError:
        return None
