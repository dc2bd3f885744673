"""`docker compose up`: the images build, every container gets well, and the arm follows its target."""

import json
import os
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from armsight_operator.stack import free_port

ROOT = Path(__file__).parents[1]
PROJECT = "armsight-test"
BUILD_S, UP_S = 2400, 120

pytestmark = [pytest.mark.docker, pytest.mark.timeout(BUILD_S + 300)]


class Compose:
    """The project's compose file, as a user calls it, under a name of its own."""

    def __init__(self) -> None:
        self._environment = os.environ | {"ARMSIGHT_PORT": str(free_port())}

    def __call__(self, *words: str, timeout_s: float = UP_S) -> str:
        command = ["docker", "compose", "--project-name", PROJECT, *words]
        ended = subprocess.run(
            command, cwd=ROOT, env=self._environment, capture_output=True, text=True, timeout=timeout_s, check=False
        )
        assert ended.returncode == 0, f"{' '.join(command)}: {ended.stderr[-4000:]}"
        return ended.stdout

    def status(self) -> dict[str, Any]:
        ended = subprocess.run(
            ["docker", "compose", "--project-name", PROJECT, "exec", "-T", "operator", "armsight", "status", "--json"],
            cwd=ROOT,
            env=self._environment,
            capture_output=True,
            text=True,
            timeout=30,
            check=False,
        )
        return dict(json.loads(ended.stdout)) if ended.stdout else {"ready": False, "said": ended.stderr}

    def wait_until_it_follows(self, timeout_s: float) -> dict[str, Any]:
        deadline = time.monotonic() + timeout_s
        while not ((status := self.status())["ready"] and (status["error_m"] or 9) < 0.3):
            assert time.monotonic() < deadline, f"not within {timeout_s:g} s: {status}\n{self('logs', '--tail', '20')}"
        return status


@pytest.fixture(scope="module")
def compose() -> Iterator[Compose]:
    compose = Compose()
    compose("build", timeout_s=BUILD_S)
    compose("up", "--detach", "--wait")
    yield compose
    compose("down", "--volumes", "--timeout", "5")


def test_arm_follows_its_target_in_containers(compose: Compose) -> None:
    status = compose.wait_until_it_follows(60)
    assert status["mode"] == "track"
    assert status["rate_hz"] > 5


def test_the_solvers_run_compiled_though_the_image_has_no_compiler(compose: Compose) -> None:
    ask = "from armsight_control.solvers.packages import prepare; print(*prepare(), sep='\\n')"
    backends, trouble = compose("exec", "-T", "control", "python3", "-c", ask).split("\n")[:2]
    assert trouble == ""
    assert backends.count("compiled") == len(backends.split(", ")) == 4


@pytest.mark.parametrize("victim", ["router", "sim", "vision", "control"])
def test_killed_container_comes_back_and_the_arm_goes_on(compose: Compose, victim: str) -> None:
    compose.wait_until_it_follows(60)
    compose("kill", "--signal", "KILL", victim)
    compose("up", "--detach", "--wait")
    compose.wait_until_it_follows(60)


def test_no_container_runs_as_root_or_can_write_to_its_image(compose: Compose) -> None:
    for service in ("router", "sim", "vision", "control", "operator"):
        assert compose("exec", "-T", service, "id", "-u").strip() == "10001", service
        write = subprocess.run(
            ["docker", "compose", "--project-name", PROJECT, "exec", "-T", service, "touch", "/usr/local/file"],
            cwd=ROOT,
            env=os.environ | {"ARMSIGHT_PORT": "1"},
            capture_output=True,
            check=False,
        )
        assert write.returncode != 0, service
