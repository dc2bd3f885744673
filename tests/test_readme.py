"""README's commands do what README says."""

import re
import shlex
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from armsight_operator.stack import Stack, free_port
from rig import Rig, started

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
ENDPOINT = "tcp/127.0.0.1:7447"


def commands(heading: str) -> list[str]:
    """The lines of the first shell block under a heading."""
    section = README.split(f"## {heading}\n", 1)[1].split("\n## ", 1)[0]
    block = re.search(r"```sh\n(.*?)```", section, re.DOTALL)
    assert block, f"no commands under {heading!r}"
    return [line.split("#")[0].strip() for line in block.group(1).splitlines() if line.split("#")[0].strip()]


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """A stack that stays well on two cores while commands start beside it: `armsight status` says 1 where it is not."""
    with started(Stack(out=tmp_path_factory.mktemp("stack"), target="none", mode="hold", fps=15)) as rig:
        yield rig


@pytest.fixture
def alone(tmp_path: Path) -> Iterator[tuple[Rig, list[subprocess.Popen[bytes]]]]:
    """README's four terminals, on a port of their own, started in its order."""
    port = free_port()
    lines = [
        line.replace(ENDPOINT, f"tcp/127.0.0.1:{port}") for line in commands("Run each part in a terminal of its own")
    ]
    assert all(str(port) in line for line in lines), "a command of README names no endpoint"
    terminals = [subprocess.Popen(shlex.split(line), cwd=ROOT) for line in lines]
    rig = Rig(Stack(out=tmp_path, port=port))
    yield rig, terminals
    rig.close()
    for terminal in terminals:
        terminal.terminate()
    for terminal in terminals:
        terminal.wait(timeout=5)


def test_each_part_runs_in_a_terminal_of_its_own(alone: tuple[Rig, list[subprocess.Popen[bytes]]]) -> None:
    rig, terminals = alone
    rig.wait_ready()
    rig.wait_until(rig.moving, 20, "the arm follows its target")
    assert [terminal.poll() for terminal in terminals] == [None] * len(terminals)


def test_commands_to_talk_to_it_work(running: Rig) -> None:
    lines = [line for line in commands("Talk to it") if line.startswith("armsight ")]
    assert len(lines) >= 6
    for line in lines:
        words = [*shlex.split(line), *([] if line == "armsight topics list" else ["--connect", running.stack.endpoint])]
        result = subprocess.run(
            [ROOT / ".venv/bin/armsight", *words[1:]], capture_output=True, text=True, timeout=30, check=False
        )
        assert result.returncode == 0, f"{line}: {result.stdout}{result.stderr}"
        assert result.stdout, line
