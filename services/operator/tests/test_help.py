"""Every command teaches by example, completes in a shell, and is on the page of commands as it is."""

import importlib.util
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from armsight import topics
from armsight_operator.cli.app import main
from armsight_operator.cli.reference import every_command, help_of

ROOT = Path(__file__).parents[3]
COMMANDS = list(every_command())
NAMES = [" ".join(path) for path, _ in COMMANDS]


def test_the_commands_are_there() -> None:
    assert {"up", "status", "topics echo", "certs make", "metrics", "trace", "doctor", "report"} <= set(NAMES)


@pytest.mark.parametrize(("path", "command"), COMMANDS, ids=NAMES)
def test_help_has_an_example_that_can_be_typed(path: tuple[str, ...], command: Any) -> None:
    example = re.search(r"Example: (armsight .*)", help_of(path, command))
    assert example, f"`armsight {' '.join(path)} --help` has no example"
    words = shlex.split(example[1])[1:]
    assert tuple(words[: len(path)]) == path
    # options, numbers and their limits are checked as they are when it runs
    command.make_context(" ".join(path), words[len(path) :])


@pytest.mark.parametrize("path", [path for path, _ in COMMANDS], ids=NAMES)
def test_help_that_is_asked_for_is_no_error(path: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([*path, "--help"])
    assert not ended.value.code
    out = capsys.readouterr().out
    assert out.startswith(f"Usage: armsight {' '.join(path)}")
    assert "Example: armsight" in out


def test_the_generated_pages_say_what_help_and_contract_say() -> None:
    spec = importlib.util.spec_from_file_location("reference_docs", ROOT / "tools" / "reference_docs.py")
    assert spec is not None
    assert spec.loader is not None
    tool = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = tool  # its dataclasses look for their module there
    spec.loader.exec_module(tool)
    texts = {each.page.name: each.page.read_text(encoding="utf-8") for each in tool.PAGES}
    for each in tool.PAGES:
        text = texts[each.page.name]
        assert text == each.text(text), f"{each.page.name}: run `.venv/bin/python tools/reference_docs.py`"
    assert all(f"### armsight {name}\n" in texts["cli.md"] for name in NAMES)
    keys = [topic.key for topic in topics.TOPICS] + [query.key for query in topics.QUERIES]
    assert all(f"| `{key}` |" in texts["keys.md"] for key in keys)
    assert "| `hold` = 3 | bool | An answer without motion: `joints` is ignored" in texts["messages.md"]


def completed(*words: str) -> set[str]:
    """What bash is told to offer for the last word."""
    environment = os.environ | {
        "_ARMSIGHT_COMPLETE": "complete_bash",
        "COMP_WORDS": " ".join(("armsight", *words)),
        "COMP_CWORD": str(len(words)),
    }
    code = "from armsight_operator.cli.app import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (("sta",), {"status"}),
        (("topics", "e"), {"echo"}),
        (("trace", "--ch"), {"--chrome"}),
        (("report", "--qu"), {"--quick"}),  # imported late
    ],
)
def test_tab_completes_commands_and_options(words: tuple[str, ...], offered: set[str]) -> None:
    assert completed(*words) == offered


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_can_be_shown_for_a_shell(shell: str) -> None:
    code = "from armsight_operator.cli.app import main; main()"
    environment = os.environ | {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code, "--show-completion", shell],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "_ARMSIGHT_COMPLETE" in done.stdout
