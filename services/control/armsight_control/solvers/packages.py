"""Ahead-of-time compiled blocks: which there are, where their packages lie, and whether this machine may run one.

What differs between versions of torch (2.6 in Debian's image, 2.15 in development) is decided here alone, by asking
what they have.
"""

import hashlib
import json
import os
import platform
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from typing import Literal

import torch
from torch._C import _aoti

from armsight_control import torch_kinematics
from armsight_control.solvers import blocks

Kind = Literal["descent", "damped"]
MODULES: dict[Kind, type[torch.nn.Module]] = {"descent": blocks.Descent, "damped": blocks.Damped}
DTYPES: dict[Kind, torch.dtype] = {"descent": torch.float32, "damped": torch.float64}

PREPARED = (3, 4)
"""Free joints: the report's arm with joint 2 held, and with all four."""

COMPILED = Path(__file__).parent / "compiled"
"""Where `python -m armsight_control.solvers.compile` puts them."""
_COMPILE = "python -m armsight_control.solvers.compile"
MAKE = f"run `{_COMPILE}`, which needs a C++ compiler"

Call = Callable[[Sequence[torch.Tensor]], Sequence[torch.Tensor]]


@dataclass(frozen=True, slots=True)
class Baseline:
    """What a package asks of the CPU that runs it."""

    march: str
    """For the compiler."""
    vector_bits: int
    flags: tuple[str, ...]
    """As /proc/cpuinfo calls them."""


# An image may run on another CPU than it was built on. AVX2 has been in servers and desktops since 2013 to 2015;
# without vectors a block takes several times as long.
BASELINES: dict[str, Baseline] = {
    "x86_64": Baseline("x86-64-v3", 256, ("avx2", "fma", "bmi1", "bmi2", "f16c", "movbe")),
    "aarch64": Baseline("armv8-a", 128, ("asimd",)),
}


@dataclass(frozen=True, slots=True)
class Metadata:
    """What lies beside a package."""

    torch: str
    machine: str
    march: str
    flags: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Block:
    """A block that can be called, and how it runs."""

    call: Call
    backend: Literal["compiled", "eager", "torch.compile"]
    trouble: str = ""
    """Why it is not compiled; empty where it is as wanted."""


def path_of(kind: Kind, joints: int, folder: Path = COMPILED) -> Path:
    """Where the package for so many free joints lies: its name has the version of torch and of the source in it."""
    return folder / f"{kind}-{joints}-{_versions()}.pt2"


def superseded(folder: Path) -> list[Path]:
    """Packages of another torch or source, and what lies beside them."""
    found = [path for suffix in (".pt2", ".json") for path in folder.glob(f"*-torch*{suffix}")]
    return [path for path in found if not path.stem.endswith(f"-{_versions()}")]


def _versions() -> str:
    sources = (blocks.__file__, torch_kinematics.__file__)
    digest = hashlib.sha256(b"".join(Path(source).read_bytes() for source in sources if source)).hexdigest()[:12]
    return f"torch{torch.__version__}-{digest}"


@lru_cache(maxsize=32)
def block(kind: Kind, joints: int, on_demand: bool = False, folder: Path = COMPILED) -> Block:
    """Loads a block, in milliseconds; without a package that fits it runs eagerly, and says why.

    Args:
        kind: which.
        joints: how many are free.
        on_demand: compile it with `torch.compile` where there is no package: takes up to a minute, for development.
        folder: where packages lie.
    """
    module = MODULES[kind]().eval()
    path = path_of(kind, joints, folder)
    refusal = refusal_of(path)
    if not refusal:
        try:
            return Block(_load(path), "compiled")
        except RuntimeError as error:
            said = str(error).splitlines()[0]
            refusal = f"its package can't be loaded ({said}); let programs run from {gettempdir()}, or {MAKE}"
    if on_demand:
        compiled = torch.compile(module, fullgraph=True, dynamic=True)
        return Block(lambda tensors: compiled(*tensors), "torch.compile")
    eager = torch.inference_mode()(module)
    if joints not in PREPARED:
        refusal = refusal.replace(_COMPILE, f"{_COMPILE} --joints {' '.join(map(str, (*PREPARED, joints)))}")
    return Block(lambda tensors: eager(*tensors), "eager", f"{kind} for {joints} joints runs uncompiled: {refusal}")


def prepare() -> tuple[str, str]:
    """Loads what the report's arm needs; says which backend each block has, and what is missing."""
    loaded = {(kind, joints): block(kind, joints) for kind in MODULES for joints in PREPARED}
    backends = ", ".join(f"{kind} of {joints} joints {one.backend}" for (kind, joints), one in loaded.items())
    return backends, next((one.trouble for one in loaded.values() if one.trouble), "")


def refusal_of(path: Path) -> str:
    """Why a package can't be used here; empty where it can."""
    described = path.with_suffix(".json")
    if not (path.is_file() and described.is_file()):
        return f"no package for this torch and source; {MAKE}"
    try:
        metadata = Metadata(**json.loads(described.read_text(encoding="utf-8")))
    except (ValueError, TypeError) as error:
        return f"{described.name} can't be read ({error}); {MAKE}"
    if metadata.torch != torch.__version__:
        return f"package made with torch {metadata.torch}, here is {torch.__version__}; {MAKE}"
    if metadata.machine != platform.machine():
        return f"package made for {metadata.machine}, here is {platform.machine()}; {MAKE}"
    missing = [flag for flag in metadata.flags if flag not in cpu_flags()]
    return f"package needs {metadata.march}: this CPU lacks {', '.join(missing)}" if missing else ""


@lru_cache(maxsize=1)
def cpu_flags() -> frozenset[str]:
    """The instruction sets of this CPU."""
    found: set[str] = set()
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        name, _, values = line.partition(":")
        if name.strip() in ("flags", "Features"):
            found.update(values.split())
    return frozenset(found)


def describe(path: Path, baseline: Baseline) -> None:
    """Writes what a package asks for beside it."""
    metadata = Metadata(torch.__version__, platform.machine(), baseline.march, baseline.flags)
    path.with_suffix(".json").write_text(json.dumps(asdict(metadata)) + "\n", encoding="utf-8")


def inductor_options(baseline: Baseline, wrapper: Path) -> dict[str, object]:
    """Inductor's settings for one baseline, on whatever version of torch.

    Args:
        baseline: the CPU to compile for.
        wrapper: a compiler that adds the baseline's flag, for versions that only know `-march=native`.
    """
    from torch._inductor import config

    # one thread: a solve is shorter than waking a second
    options: dict[str, object] = {"cpp.threads": 1, "cpp.simdlen": baseline.vector_bits}
    return options | ({"cpp.march": baseline.march} if hasattr(config.cpp, "march") else {"cpp.cxx": (str(wrapper),)})


def _load(path: Path) -> Call:
    with _unpacked_elsewhere():
        # inductor's own function for this would first import inductor, which takes seconds
        try:
            loaded = _aoti.AOTIModelPackageLoader(str(path), "model", True)  # run_single_threaded: no pool, no locks
        except TypeError:  # torch 2.6 takes two arguments
            loaded = _aoti.AOTIModelPackageLoader(str(path), "model")
    return lambda tensors: loaded.run(list(tensors))


@contextmanager
def _unpacked_elsewhere() -> Iterator[None]:
    """A folder for what torch unpacks, removed once it is loaded: torch itself leaves it behind when it is killed."""
    before = os.environ.get("TMPDIR")
    with TemporaryDirectory(prefix="armsight-solvers-") as folder:
        os.environ["TMPDIR"] = folder
        try:
            yield
        finally:
            if before is None:
                del os.environ["TMPDIR"]
            else:
                os.environ["TMPDIR"] = before
