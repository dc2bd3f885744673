import stat
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import plain_bus
import pytest

from armsight.bus import Bus
from armsight_operator.stack import NAMES, Stack
from armsight_operator.stack.executables import VISION_VARIABLE
from fake_arm import FakeArm

PYTHON = sys.executable
SCRIPTS = {"router": "armsight", "sim": "armsight-sim", "control": "armsight-control", "vision": "armsight-vision"}

OBEDIENT = "import time\nprint(' '.join(sys.argv[1:]), flush=True)\ntime.sleep(60)\n"


@pytest.fixture
def scripts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder where the stack looks for executables."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv(VISION_VARIABLE, str(folder / "armsight-vision"))
    monkeypatch.setattr(sys, "executable", str(folder / "python"))
    return folder


@pytest.fixture
def fake(scripts: Path) -> Callable[..., Path]:
    """Writes an executable that stands for a service; by default one that waits for SIGTERM."""

    def write(name: str, code: str = OBEDIENT) -> Path:
        path = scripts / SCRIPTS[name]
        path.write_text(f"#!{PYTHON} -S\nimport sys\n{code}")
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
        return path

    for name in NAMES:
        write(name)
    return write


@pytest.fixture
def stack(fake: Callable[..., Path], tmp_path: Path) -> Iterator[Stack]:
    """A stack of fakes."""
    del fake
    with Stack(out=tmp_path / "out") as stack:
        yield stack


@pytest.fixture
def endpoint() -> Iterator[str]:
    """A router's."""
    with plain_bus.router() as endpoint:
        yield endpoint


@pytest.fixture
def make_bus(endpoint: str) -> Iterator[Callable[[], Bus]]:
    """Opens places on the router's bus."""
    opened: list[Bus] = []

    def make() -> Bus:
        opened.append(plain_bus.opened(endpoint))
        return opened[-1]

    yield make
    for bus in opened:
        bus.session.close()  # type: ignore[no-untyped-call]


@pytest.fixture
def arm(make_bus: Callable[[], Bus]) -> FakeArm:
    """Something that answers as sim and control do."""
    return FakeArm(make_bus())
