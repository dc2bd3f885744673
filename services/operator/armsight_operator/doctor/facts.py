"""What there is on this machine: everything that the checks are told. Failing to find out is a fact, too."""

import ctypes
import importlib.metadata
import importlib.util
import re
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import armsight_operator
from armsight import shared_memory
from armsight.session import SessionConfig, refusal
from armsight_operator.doctor.machine import ClockFacts, Holder, holder_of, listening_ports
from armsight_operator.doctor.network import BusFacts, Heard
from armsight_operator.doctor.software import Answer, pinned_in
from armsight_operator.errors import NoRouterError

_LOOK_S = 0.3
_GATHER_S = 2.2
"""Two periods of health."""
_START_S = 60.0
"""For a Python that imports torch on a busy machine."""

# Asked in processes of their own: neither MuJoCo nor torch belongs into the operator's, and either may be absent.
_GL = "from armsight_sim.gl import choose_gl; print(choose_gl())"
_SOLVERS = """
from armsight_control.solvers import packages
for kind in packages.MODULES:
    for joints in packages.PREPARED:
        print(f"{kind} for {joints} joints: {packages.refusal_of(packages.path_of(kind, joints))}")
"""

_ZENOH_IN_BINARY = re.compile(rb"/zenoh-([0-9]+\.[0-9]+\.[0-9]+)/")
"""A Rust program has its sources' paths with it, for its panics."""

_UNSYNCHRONISED = 5
_TIMEX_BYTES = 512
"""More than the kernel's structure has anywhere."""


def ask(command: Sequence[str], timeout_s: float) -> Answer:
    """Runs another program to its end."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=timeout_s, check=False)
    except subprocess.TimeoutExpired:
        return Answer(None, error=f"it did not end within {timeout_s:g} s")
    except OSError as error:
        return Answer(None, error=f"{command[0]}: {error.strerror}")
    return Answer(done.returncode, done.stdout, done.stderr)


def graphics() -> Answer | None:
    """Which OpenGL sim draws with; nothing where sim is not installed."""
    return _ask_package("armsight_sim", _GL)


def compiled_solvers() -> Answer | None:
    """Which blocks are compiled for this CPU; nothing where control is not installed."""
    return _ask_package("armsight_control", _SOLVERS)


def docker() -> Answer:
    """The daemon's version."""
    return ask(["docker", "version", "--format", "{{.Server.Version}}"], 5.0)


def zenoh_of(executable: Path) -> str:
    """The version of Zenoh that a program was built with; empty where it doesn't say."""
    try:
        found = _ZENOH_IN_BINARY.search(executable.read_bytes())
    except OSError:
        return ""
    return found[1].decode() if found else ""


def installed_version(package: str) -> str:
    """Empty where it is not installed."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""


def installed() -> dict[str, str]:
    """Versions of all packages by their normalised names."""
    found = ((one.metadata["Name"], one.version) for one in importlib.metadata.distributions())
    return {re.sub(r"[-_.]+", "-", name).lower(): version for name, version in found if name}


def pinned(root: Path) -> dict[str, str] | None:
    """Of requirements.txt; nothing where there is none, as in an image."""
    try:
        return pinned_in((root / "requirements.txt").read_text(encoding="utf-8"))
    except OSError:
        return None


def unmet() -> list[str]:
    """What armsight-operator needs and does not have, with what is there."""
    from packaging.requirements import Requirement

    asked = [Requirement(text) for text in importlib.metadata.requires("armsight-operator") or ()]
    needed = [one for one in asked if one.marker is None or one.marker.evaluate({"extra": ""})]
    return [
        f"{one.name} {version or 'missing'}"
        for one in needed
        if not (version := installed_version(one.name)) or not one.specifier.contains(version, prereleases=True)
    ]


def memory_lock() -> tuple[bool, int | None, int]:
    """Whether the pool's memory may be locked, the limit and what is needed, bytes; no limit is None."""
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    limit = None if soft == resource.RLIM_INFINITY else soft
    return shared_memory.may_lock(shared_memory.LOCK_BYTES), limit, shared_memory.LOCK_BYTES


def free_disk(folder: Path) -> int:
    """Bytes."""
    return shutil.disk_usage(folder).free


def clock() -> ClockFacts:
    """Looks at both clocks during a short wait."""
    newest_s = Path(armsight_operator.__file__).stat().st_mtime
    wall_s, monotonic_s = time.time(), time.monotonic()
    time.sleep(_LOOK_S)
    wall_took_s, monotonic_took_s = time.time() - wall_s, time.monotonic() - monotonic_s
    return ClockFacts(wall_s, newest_s, wall_took_s, monotonic_took_s, _synchronised())


def holder(port: int) -> Holder | None:
    """Who listens at a port of this machine."""
    listening: dict[int, int] = {}
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        with suppress(OSError):
            listening |= listening_ports(Path(table).read_text(encoding="ascii"))
    return holder_of(port, listening, _owner_of(listening[port])) if port in listening else None


def bus(config: SessionConfig) -> BusFacts:
    """Joins the bus, and listens for two periods of health."""
    from armsight_operator.cli.bus import connected
    from armsight_operator.metrics import Watch

    try:
        with connected(config) as place:
            watch = Watch()
            watch.listen(place)
            until = time.monotonic() + _GATHER_S
            while time.monotonic() < until and any(one.age_s is None for one in watch.observe().services):
                time.sleep(0.1)
            services = watch.observe().services
    except NoRouterError:
        return BusFacts(config.endpoints, connected=False, refusal=refusal(config))
    heard = tuple(Heard(one.state.name, one.state.status, one.state.detail, one.version) for one in services)
    return BusFacts(config.endpoints, connected=True, refusal="", services=heard)


def _ask_package(name: str, code: str) -> Answer | None:
    return ask([sys.executable, "-c", code], _START_S) if importlib.util.find_spec(name) is not None else None


def _synchronised() -> bool | None:
    """What the kernel's clock discipline says; needs no right."""
    libc = ctypes.CDLL(None, use_errno=True)
    if not hasattr(libc, "adjtimex"):
        return None
    state = int(libc.adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES)))
    return None if state < 0 else state != _UNSYNCHRONISED


def _owner_of(inode: int) -> dict[int, Holder]:
    link = f"socket:[{inode}]"
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # another user's, or it just ended
            if any(str(entry.readlink()) == link for entry in (folder / "fd").iterdir()):
                words = (folder / "cmdline").read_bytes().split(b"\0")
                command = b" ".join(word for word in words if word).decode(errors="replace")[:120]
                return {inode: Holder(int(folder.name), command)}
    return {}
