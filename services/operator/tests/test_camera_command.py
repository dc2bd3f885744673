"""`armsight camera` is `armsight-camera`."""

import subprocess
import sys
from pathlib import Path

# the command as it is where these scripts are
RUN = "import sys; sys.executable = sys.argv.pop(1); from armsight_operator.cli.app import main; main(sys.argv[1:])"
SAYS = "import sys; print(sys.argv[1:]); sys.exit(3)"


def camera(scripts: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-c", RUN, str(scripts / "python"), "camera", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)


def test_all_arguments_and_the_exit_code_are_the_services(tmp_path: Path) -> None:
    executable = tmp_path / "armsight-camera"
    executable.write_text(f"#!{sys.executable}\n{SAYS}\n", encoding="utf-8")
    executable.chmod(0o755)
    words = ["--device", "left=0", "--calibration", "c.json", "--loop", "--health"]
    done = camera(tmp_path, *words)
    assert done.returncode == 3
    assert done.stdout == f"{words}\n"


def test_where_it_is_not_installed_it_is_said_how_to_get_it(tmp_path: Path) -> None:
    done = camera(tmp_path, "--device", "0")
    assert done.returncode == 1
    assert "camera is not installed" in done.stderr
    assert "make setup" in done.stderr
