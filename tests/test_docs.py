"""The documentation does what it says: every command in it runs here, or in the test that the table below names.

A page is gone through as a reader would, block by block, in a folder of its own, on one stack with few frames a second.
What differs from what the reader types stands in the tables at the top, and nowhere else.
"""

import ast
import contextlib
import io
import json
import os
import re
import runpy
import shlex
import signal
import subprocess
import sys
import time
import tomllib
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest
import yaml

from armsight_operator.cli.reference import every_command
from armsight_operator.stack import Stack, free_port
from rig import Rig, started

ROOT = Path(__file__).parents[1]
PAGES = (
    "README.md",
    "ARCHITECTURE.md",
    *sorted(str(page.relative_to(ROOT)) for page in (*ROOT.glob("docs/**/*.md"), *ROOT.glob("services/*/docs/*.md"))),
)
ENDPOINT = "tcp/127.0.0.1:7447"
RECORDED_S = 2.0


@dataclass(frozen=True, slots=True)
class Started:
    """A command that goes on until it is told to end: it says this, goes on, and ends with 0 on SIGTERM."""

    says: str
    extra: str = ""
    """Appended: a port that nobody else has."""
    runs_s: float = 0.0
    """How long the reader lets it run."""


# By what a command begins with; all others run to their end, with exit code 0 and something said.
STARTED: Mapping[str, Started] = {
    "armsight record run.mcap": Started("records to", runs_s=RECORDED_S),
    "armsight record": Started("records to"),
    "armsight router": Started("", "--listen {other}"),
    "build/vision/armsight-vision --namespace robots/a": Started("", runs_s=2.0),
    "build/vision/armsight-vision --namespace": Started(""),
    "build/vision/armsight-vision": Started("", "--connect {other}"),
    "armsight replay run.mcap --rate 0.2": Started("replays"),
    "armsight metrics": Started(r"http://127.0.0.1:\d+/metrics", "--port 0", runs_s=2.5),
    "armsight bridge foxglove": Started(r"ws://127.0.0.1:\d+", "--port {port}"),
    "armsight page": Started(r"http://127.0.0.1:\d+", "--port {port}"),
    "armsight trace": Started(r"\bms\b"),
}
# They begin so, and end by themselves.
ENDS = ("armsight trace -", "build/vision/armsight-vision --calibration")

# The same with less waiting: 300 frames take 20 s here.
SHORTER = {"--frames 300": "--frames 20", "-n 30": "-n 10", "--seconds 5": "--seconds 1"}

# What some of them say when they end.
SAYS: Mapping[str, str] = {
    "armsight status": r"sim .*\n(?: +.*\n)*vision",
    "armsight topics list": "joints/positions",
    "armsight topics echo control/status": '"target_reachable": true',
    "armsight params list": "speed",
    "armsight recording info run.mcap": r"joints/positions",
    "armsight replay run.mcap --lockstep": r"replayed [1-9]\d* messages, [1-9]\d* instants answered",
    "armsight replay run.mcap --namespace": r"replayed [1-9]\d* messages, [1-9]\d* instants answered",
    "armsight replay run.mcap": r"replayed [1-9]\d* messages",
    "armsight certs show": "operator",
    "build/vision/armsight-vision --calibration": '"yellow"',
}
QUIET = (". .venv/bin/activate",)

# They take long, and are not run again where another page has run them.
ONCE = ("armsight report --from run.mcap --out report-out", "armsight export run.mcap --csv tables")

# And what is then true.
AFTER: "Mapping[str, Callable[[Rig, Path], None]]" = {
    "armsight target 3.0 1.0 7.0": lambda rig, _: rig.wait_until(
        lambda: rig.tip_error((3.0, 1.0, 7.0)) < 0.05, 20, "the tip is at the target"
    ),
    "armsight target 8.0 2.0 7.0": lambda rig, _: rig.wait_until(
        lambda: rig.tip_error((5.470, 1.368, 6.051)) < 0.05, 20, "the tip is at the nearest point that it reaches"
    ),
    "armsight move 0.5 0 0.8 -0.4": lambda rig, _: rig.wait_until(
        lambda: bool(np.abs(rig.true_joints() - (0.5, 0.0, 0.8, -0.4)).max() < 0.01), 20, "the joints are there"
    ),
    "armsight stop": lambda rig, _: rig.wait_until(
        lambda: rig.control_state() == "STOPPED" and not rig.moving(), 5, "the arm stands"
    ),
    "armsight release": lambda rig, _: rig.wait_until(
        lambda: rig.control_state() in ("MOVING", "HOLDING"), 5, "the arm may move"
    ),
    "armsight mode track": lambda rig, _: rig.wait_until(
        lambda: rig.control_state() in ("MOVING", "HOLDING"), 5, "the arm may move"
    ),
    "armsight snapshot": lambda _, folder: none_missing(folder / "snap", "calibration.json", "camera-1.png"),
    "build/vision/armsight-vision --calibration": lambda _, folder: none_missing(folder / "found", "1.png", "2.png"),
    "armsight export": lambda _, folder: none_missing(folder / "tables", "positions.csv", "command.csv"),
    "armsight report": lambda _, folder: none_missing(folder / "report-out", "report.html", "summary.json"),
    "armsight trace --frames 300 --chrome": lambda _, folder: none_missing(folder, "frames.json"),
    "armsight certs": lambda _, folder: none_missing(folder / "certs", "router/zenoh.json5", "ca/key.pem"),
}


def none_missing(folder: Path, *names: str) -> None:
    assert [name for name in names if not (folder / name).is_file()] == [], sorted(folder.rglob("*"))


COMPOSE, SECURE = "tests/test_compose.py::", "tests/test_compose_secure.py::"
FILES, CERTS = "tests/test_compose_files.py::", "tests/test_secure.py::"
MACHINES = SECURE + "test_two_machines_with_a_router_each"
LINKED = "tests/test_two_machines.py::test_loop_runs_over_the_link_and_frames_stay_where_they_are_read"
OWN = "tests/test_examples.py::test_the_loop_closes_over_"
CAMERAS = "tests/test_camera.py::test_arm_is_measured_and_answered_through_cameras_that_are_not_sims"
HERE, REPORT = "tests/test_docs.py::", "tests/test_report.py::"
CALIBRATE = "tests/test_calibrate.py::"

# Command → the test that runs it, or what it stands for.
ELSEWHERE: Mapping[str, str] = {
    "git clone <this repository> armsight && cd armsight": ".ci/run",  # runs in a clone
    "make run": HERE + "test_make_run_is_armsight_up",
    "docker compose up --build --wait": COMPOSE + "test_arm_follows_its_target_in_containers",
    "docker compose exec operator armsight status": COMPOSE + "test_arm_follows_its_target_in_containers",
    ".venv/bin/armsight router --listen tcp/127.0.0.1:7447": HERE + "test_each_part_runs_in_a_terminal_of_its_own",
    ".venv/bin/armsight-sim --target default --connect tcp/127.0.0.1:7447": HERE
    + "test_each_part_runs_in_a_terminal_of_its_own",
    "build/vision/armsight-vision --connect tcp/127.0.0.1:7447": HERE + "test_each_part_runs_in_a_terminal_of_its_own",
    ".venv/bin/armsight-control --mode track --connect tcp/127.0.0.1:7447": HERE
    + "test_each_part_runs_in_a_terminal_of_its_own",
    ".venv/bin/armsight report --out report-out --quick": REPORT + "test_pictures_and_markdown_are_written",
    # docs/own-arm.md
    "armsight up --model services/sim/armsight_sim/models/five.xml": "tests/test_another_arm.py::test_up_runs_a_model",
    # docs/own-camera.md
    "armsight-sim --external-cameras 1 2": CAMERAS,
    "armsight-camera --device 0 --device 2 --calibration calibration.json": CAMERAS,
    "mkdir snap/1 snap/2 && cp snap/camera-1.png snap/1 && cp snap/camera-2.png snap/2": CAMERAS,
    "armsight-camera --device snap/1 --device snap/2 --calibration snap/calibration.json": CAMERAS,
    'ARMSIGHT_EXTERNAL_CAMERAS="1 2" docker compose --profile camera up --build --wait': COMPOSE
    + "test_vision_measures_what_cameras_in_a_container_bring",
    # docs/calibrate.md
    "pip install 'armsight-operator[calibrate]'": HERE + "test_opencv_is_an_extra_of_the_operator",
    "armsight calibrate intrinsics board-1 --camera 1 --board charuco:7x5 --square-m 0.04 --marker-m 0.03"
    " --picture lens-1.png": CALIBRATE + "test_the_lens_is_the_one_that_the_pictures_were_bent_by",
    "armsight record poses.mcap 'camera/**' 'joints/*' description --seconds 60": CALIBRATE
    + "test_the_camera_is_found_where_it_really_is",
    "armsight calibrate extrinsics poses.mcap --picture poses.png": CALIBRATE
    + "test_the_camera_is_found_where_it_really_is",
    "armsight calibrate colours view.png --camera 1 --at red=412,300 --at green=398,520 --at blue=380,420"
    " --at yellow=401,455 --picture cones.png": "services/operator/tests/test_calibrate_colours.py"
    "::test_the_file_gets_the_colours_and_the_picture_shows_them",
    "armsight calibrate colours poses.mcap --camera 1 --known-order": CALIBRATE
    + "test_colours_that_were_learnt_where_markers_are_expected_are_found_by_vision",
    "armsight up --calibration calibration.json": "services/operator/tests/test_stack.py"
    "::test_a_calibration_file_is_sims",
    # docs/security.md
    "armsight up --certificates certs": CERTS + "test_commands_of_the_documentation_run_the_stack",
    "armsight status --zenoh-config certs/operator/zenoh.json5": CERTS
    + "test_commands_of_the_documentation_run_the_stack",
    "armsight router --zenoh-config certs/router/zenoh.json5": CERTS + "test_arm_follows_its_target_and_obeys",
    "armsight-sim --zenoh-config certs/sim/zenoh.json5": CERTS + "test_arm_follows_its_target_and_obeys",
    "build/vision/armsight-vision --zenoh-config certs/vision/zenoh.json5": CERTS
    + "test_arm_follows_its_target_and_obeys",
    "armsight-control --zenoh-config certs/control/zenoh.json5": CERTS + "test_arm_follows_its_target_and_obeys",
    # docs/deploy.md: two machines
    "export COMPOSE_FILE=docker-compose.yml:docker-compose.secure.yml:docker-compose.center.yml": FILES
    + "test_two_machines_have_each_service_once_and_a_router_each",
    "export COMPOSE_FILE=docker-compose.yml:docker-compose.secure.yml:docker-compose.edge.yml": FILES
    + "test_two_machines_have_each_service_once_and_a_router_each",
    "export ARMSIGHT_USER=$(id -u):$(id -g) ARMSIGHT_BIND=0.0.0.0": MACHINES,
    "export ARMSIGHT_USER=$(id -u):$(id -g) ARMSIGHT_CENTER=center.local": MACHINES,
    "docker compose run --rm certs armsight certs make --folder /certs --router edge=sim,vision --host center.local"
    " --listen tls/0.0.0.0:7447 --connect tls/router:7447": MACHINES,
    "armsight-control --zenoh-config certs/control/zenoh.json5 --mode track": LINKED,
    "armsight router --zenoh-config certs/edge/zenoh.json5 --listen tls/127.0.0.1:7447"
    " --connect tls/center.local:7447": LINKED,
    "armsight-sim --zenoh-config certs/sim/zenoh.json5 --target default": LINKED,
    "armsight-vision --zenoh-config certs/vision/zenoh.json5": LINKED,
    # docs/own-part.md
    **dict.fromkeys(
        (
            "armsight router --listen tcp/127.0.0.1:7450",
            "armsight-control --solver closed-form --connect tcp/127.0.0.1:7450",
            "armsight conformance control --connect tcp/127.0.0.1:7450",
            "build/vision/armsight-vision --connect tcp/127.0.0.1:7450",
            "armsight conformance vision --connect tcp/127.0.0.1:7450",
            "armsight-sim --clock lockstep --connect tcp/127.0.0.1:7450",
            "armsight conformance sim --connect tcp/127.0.0.1:7450",
        ),
        "tests/test_conformance.py::test_our_own_services_fulfil_the_contract",
    ),
    "armsight-control --mode track --connect tcp/127.0.0.1:7450": OWN + "a_vision_of_ones_own",
    "python examples/hue_vision.py --connect tcp/127.0.0.1:7450": OWN + "a_vision_of_ones_own",
    "armsight target 3.0 2.5 7.5 --connect tcp/127.0.0.1:7450": OWN + "a_vision_of_ones_own",
    "armsight-control --estimator examples/gauss_newton_estimator.py:FromSetpoint"
    " --solver examples/least_squares_solver.py:solve": OWN + "an_estimator_and_a_solver_of_ones_own",
    "armsight describe services/sim/armsight_sim/models/arm.xml --json > arm.json": OWN + "a_learned_policy",
    "python examples/train_policy.py arm.json policy.pt": OWN + "a_learned_policy",
    "python examples/policy_controller.py policy.pt --connect tcp/127.0.0.1:7450": OWN + "a_learned_policy",
    # docs/recording.md
    "pip install 'armsight-operator[bridge]'": HERE + "test_bridge_is_an_extra_of_the_operator",
    "docker compose --profile record up --build --wait": COMPOSE
    + "test_the_recorder_is_well_and_what_it_recorded_stays",
    "docker compose --profile record run --rm --no-deps recorder"
    " sh -c 'armsight recording info /recordings/*.mcap'": COMPOSE
    + "test_the_recorder_is_well_and_what_it_recorded_stays",
    "docker compose --profile record cp recorder:/recordings .": COMPOSE
    + "test_the_recorder_is_well_and_what_it_recorded_stays",
}


# --- what stands in the pages


@dataclass(frozen=True, slots=True)
class Block:
    """What stands between two fences."""

    page: str
    language: str
    text: str
    output: str = ""
    """Of Python: the block of text that follows."""

    @property
    def commands(self) -> list[str]:
        """Of a shell block, without comments."""
        lines = self.text.replace("\\\n", " ").splitlines()
        return [" ".join(words) for line in lines if (words := _without_comment(line).split())]


def _without_comment(line: str) -> str:
    return re.sub(r"(^|\s)#.*", "", line)


@cache
def blocks(page: str) -> tuple[Block, ...]:
    text = (ROOT / page).read_text(encoding="utf-8")
    found = [
        Block(page, language, block)
        for language, block in re.findall(r"^```(\w*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    ]
    assert 2 * len(found) == len(re.findall(r"^ *```", text, re.MULTILINE)), f"{page}: a fence that nobody reads"
    return tuple(
        replace(block, output=after.text if (block.language, after.language) == ("python", "text") else "")
        for block, after in pairwise([*found, Block(page, "", "")])
    )


ALL = [block for page in PAGES for block in blocks(page)]
COMMANDS = [(block.page, command) for block in ALL if block.language == "sh" for command in block.commands]


def test_every_block_is_of_a_kind_that_is_checked() -> None:
    assert {block.language for block in ALL} <= {"sh", "python", "text", "yaml", "promql", ""}
    texts = [block for block in ALL if block.language == "text"]
    outputs = [block.output for block in ALL if block.output]
    assert [block.text for block in texts] == outputs, "text is what the Python before it prints"


def test_site_is_built_without_a_broken_link_and_fetches_nothing(tmp_path: Path) -> None:
    mkdocs = [str(Path(sys.executable).parent / "mkdocs"), "build", "--strict", "--site-dir", str(tmp_path)]
    quiet = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(mkdocs, cwd=ROOT, env=quiet, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    html = {page.relative_to(tmp_path).as_posix(): page.read_text("utf-8") for page in tmp_path.rglob("*.html")}
    assert {"index.html", "architecture.html", "tutorial.html", "messages.html", "api/control.html"} <= set(html)
    fetched = r"""<(?:script|img|iframe)[^>]*src="https?:|<link[^>]*rel="?(?:stylesheet|preconnect)[^>]*https?:"""
    assert [page for page, text in html.items() if re.search(fetched, text)] == []
    styles = [
        style for style in tmp_path.rglob("*.css") if re.search(r"(?:url\(|@import )['\"]?https?:", style.read_text())
    ]
    assert styles == []
    pictures = {(page, source) for page, text in html.items() for source in re.findall(r'<img[^>]*src="([^"]+)"', text)}
    assert [each for each in pictures if not (tmp_path / each[0]).parent.joinpath(each[1]).is_file()] == []
    assert "<math" in html["api/control.html"], "formulas of docstrings are drawn"
    sphinx = r":(?:math|func|class|meth|mod|attr|data):|\.\. math|``"
    assert [page for page, text in html.items() if page.startswith("api/") and re.search(sphinx, text)] == []
    public = re.search(
        r"__all__ = (\[.*?\])", (ROOT / "services/control/armsight_control/__init__.py").read_text(), re.DOTALL
    )
    assert public is not None
    missing = [
        name for name in ast.literal_eval(public[1]) if f'id="armsight_control.{name}"' not in html["api/control.html"]
    ]
    assert missing == [], "public names that the reference does not have"


def test_make_run_is_armsight_up() -> None:
    done = subprocess.run(["make", "-n", "run"], cwd=ROOT, capture_output=True, text=True, timeout=30, check=True)
    assert done.stdout.splitlines()[-1] == "exec .venv/bin/armsight up"


def test_bridge_is_an_extra_of_the_operator() -> None:
    table = tomllib.loads((ROOT / "services/operator/pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert table["name"] == "armsight-operator"
    assert any(need.startswith("foxglove-sdk") for need in table["optional-dependencies"]["bridge"])


def test_opencv_is_an_extra_of_the_operator() -> None:
    table = tomllib.loads((ROOT / "services/operator/pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert any(need.startswith("opencv-python-headless") for need in table["optional-dependencies"]["calibrate"])


def test_prometheus_is_told_where_metrics_are_served() -> None:
    (block,) = [block for block in ALL if block.language == "yaml"]
    (job,) = yaml.safe_load(block.text)["scrape_configs"]
    default = next(p.default for p in dict(every_command())["metrics",].params if "--port" in p.opts)
    assert job["static_configs"] == [{"targets": [f"127.0.0.1:{default}"]}]


def test_table_of_recoveries_is_what_was_measured() -> None:
    tool = runpy.run_path(str(ROOT / "tools/recovery_table.py"))
    text = tool["PAGE"].read_text(encoding="utf-8")
    assert tool["page"](text, json.loads(tool["RESULTS"].read_text(encoding="utf-8"))) == text


def test_the_table_names_commands_of_the_pages_and_tests_that_there_are() -> None:
    written = {command for _, command in COMMANDS}
    assert set(ELSEWHERE) <= written, f"nobody writes {set(ELSEWHERE) - written} any more"
    for command, place in ELSEWHERE.items():
        file, _, test = place.partition("::")
        assert (ROOT / file).is_file(), command
        assert not test or f"def {test}(" in (ROOT / file).read_text(encoding="utf-8"), f"{command}: no {place}"


NAMED = sorted(
    {
        (page, found)
        for page in PAGES
        for found in re.findall(r"`(armsight (?!end`)[a-z][^`]*)`", (ROOT / page).read_text(encoding="utf-8"))
    }
    | {(page, command) for page, command in COMMANDS if command.startswith("armsight ")}
)


@pytest.mark.parametrize(("page", "text"), NAMED)
def test_every_command_that_is_named_is_one_with_these_options(page: str, text: str) -> None:
    del page
    words = shlex.split(text.rstrip("&").split("--zenoh-config certs")[0])[1:]
    path = max(
        (path for path, _ in every_command() if tuple(words[: len(path)]) == path[: len(words)]), key=len, default=()
    )
    assert path, f"there is no {text!r}"
    command = dict(every_command())[path]
    known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
    options = {word.partition("=")[0] for word in words if re.match(r"--?[a-z]", word)}
    assert options <= known | {"--help"}, f"{text!r}: no {options - known}"


# --- each page, gone through


DONE: set[str] = set()
"""What need not be run again."""


class Reader:
    """Types what stands in a page, in a folder that looks like the repository."""

    def __init__(self, rig: Rig, folder: Path) -> None:
        self.rig, self.folder = rig, folder
        for name in (".venv", "build", "services"):
            (folder / name).symlink_to(ROOT / name)
        path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        self._environment = os.environ | {"ARMSIGHT_CONNECT": rig.stack.endpoint, "PATH": path}
        self._notebook: dict[str, Any] = {"__name__": "notebook"}
        self._metrics = ""
        self._running: list[tuple[str, subprocess.Popen[bytes]]] = []

    def go_through(self, block: Block) -> None:
        if block.language == "python":
            self._python(block)
        if block.language == "promql":
            self._queries(block)
        if block.language == "yaml":
            assert yaml.safe_load(block.text), "nothing in it"
        if block.language != "sh":
            return
        environment = dict(self._environment)
        for line in (line for line in block.commands if line not in ELSEWHERE and line not in DONE):
            for command in line.removesuffix("&").split(" & "):
                if command.startswith("armsight router"):  # the rest of the block is about this one
                    environment["ARMSIGHT_CONNECT"] = f"tcp/127.0.0.1:{free_port()}"
                self._type(command.strip(), environment, waits=not line.endswith("&"))
        self.end()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        """Leaves nothing running, whatever went wrong."""
        for _, process in self._running:
            process.kill()
            process.wait()

    def end(self) -> None:
        """Ends what goes on, the last first."""
        while self._running:
            command, process = self._running.pop()
            assert process.poll() is None, f"{command} ended by itself with {process.returncode}"
            process.send_signal(signal.SIGTERM)
            assert process.wait(10) == 0, command

    def _type(self, command: str, environment: dict[str, str], *, waits: bool) -> None:
        how = _longest(STARTED, command)
        if how is None or command.startswith(ENDS):
            self._run(command, environment)
            return
        port, other = free_port(), environment["ARMSIGHT_CONNECT"]
        extra = how.extra.format(port=port, other=other)
        if extra.startswith("--port"):
            command = re.sub(r" --port \d+", "", command)
        log = self.folder / f"output-{port}"
        with log.open("wb") as out:
            words = [*shlex.split(command), *shlex.split(extra)]
            process = subprocess.Popen(
                words, cwd=self.folder, env=environment, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT
            )
        self._running.append((command, process))
        self.rig.wait_until(
            lambda: process.poll() is not None or bool(re.search(how.says, log.read_text())), 20, f"{command} says so"
        )
        assert process.poll() is None, f"{command}: {log.read_text()}"
        if waits:
            self.rig.pause(how.runs_s)
            if found := re.search(r"http://[^/\s]+/metrics", log.read_text()):
                with urllib.request.urlopen(found[0], timeout=5) as answer:  # noqa: S310  our own
                    self._metrics = answer.read().decode()
            self.end()

    def _run(self, command: str, environment: dict[str, str]) -> None:
        shorter = command
        for long, short in SHORTER.items():
            shorter = shorter.replace(long, short)
        began = time.monotonic()
        done = subprocess.run(
            ["bash", "-c", shorter],
            cwd=self.folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        print(f"{time.monotonic() - began:5.1f} s  {command}")
        assert done.returncode == 0, f"{command}: {done.stdout}{done.stderr}"
        assert done.stdout or command in QUIET, f"{command} says nothing"
        if (says := _longest(SAYS, command)) is not None:
            assert re.search(says, done.stdout), f"{command}: {done.stdout}"
        if (check := _longest(AFTER, command)) is not None:
            check(self.rig, self.folder)
        if command in ONCE:
            DONE.add(command)

    def _queries(self, block: Block) -> None:
        """What they ask for is what is served, on this page above and in its table."""
        assert self._metrics, "no `armsight metrics` above"
        served = set(re.findall(r"^# TYPE (\w+)", self._metrics, re.MULTILINE))
        asked = {name.removesuffix("_bucket") for name in re.findall(r"\barmsight_\w+", block.text)}
        told = set(re.findall(r"`(armsight_\w+)`", (ROOT / block.page).read_text(encoding="utf-8")))
        assert asked, block.text
        assert asked | told <= served, sorted((asked | told) - served)
        for label in re.findall(r'\w+="\w+"', block.text):
            assert label in self._metrics, label

    def _python(self, block: Block) -> None:
        out = io.StringIO()
        text = block.text.replace(ENDPOINT, self.rig.stack.endpoint)
        with contextlib.redirect_stdout(out), contextlib.chdir(self.folder):
            exec(compile(text, block.page, "exec"), self._notebook)  # noqa: S102  it is our own page
        assert out.getvalue() == block.output, f"{block.page}: {block.text}"


def _longest(table: Mapping[str, Any], command: str) -> Any:
    """The row whose key is the longest with which the command begins."""
    return table.get(max((key for key in table if f"{command} ".startswith(f"{key} ")), key=len, default=""))


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """A stack that stays well on two cores while commands start beside it: `armsight status` says 1 where it is not.

    No slower: sim refuses it.
    """
    with started(Stack(out=tmp_path_factory.mktemp("stack"), target="default", mode="track", fps=15)) as rig:
        yield rig


@pytest.fixture
def alone(tmp_path: Path) -> Iterator[tuple[Rig, list[subprocess.Popen[bytes]]]]:
    """README's four terminals, on a port of their own, started in its order."""
    port = free_port()
    section = (ROOT / "README.md").read_text(encoding="utf-8").split("## Run each part in a terminal of its own\n")[1]
    lines = Block("README.md", "sh", re.findall(r"```sh\n(.*?)```", section, re.DOTALL)[0]).commands
    lines = [line.replace(ENDPOINT, f"tcp/127.0.0.1:{port}") for line in lines]
    assert all(str(port) in line for line in lines), "a command of README names no endpoint"
    terminals = [subprocess.Popen(shlex.split(line), cwd=ROOT) for line in lines]
    rig = Rig(Stack(out=tmp_path, port=port))
    yield rig, terminals
    rig.close()
    for terminal in terminals:
        terminal.terminate()
    for terminal in terminals:
        terminal.wait(timeout=5)


# before the stack of the others: two at once are slow
def test_each_part_runs_in_a_terminal_of_its_own(alone: tuple[Rig, list[subprocess.Popen[bytes]]]) -> None:
    rig, terminals = alone
    rig.wait_ready()
    rig.wait_until(rig.moving, 20, "the arm follows its target")
    assert [terminal.poll() for terminal in terminals] == [None] * len(terminals)


@pytest.fixture(scope="module")
def recorded(shared: Rig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """For pages that read a recording and make none."""
    file = tmp_path_factory.mktemp("recorded") / "run.mcap"
    armsight = Path(sys.executable).parent / "armsight"
    words = [str(armsight), "record", str(file), "--seconds", f"{RECORDED_S:g}", "--connect", shared.stack.endpoint]
    subprocess.run(words, check=True, timeout=30, capture_output=True)
    return file


@pytest.mark.parametrize("page", [page for page in PAGES if {b.language for b in blocks(page)} & {"sh", "python"}])
def test_page_does_what_it_says(page: str, shared: Rig, tmp_path: Path, recorded: Path) -> None:
    shared.wait_ready()
    if "armsight record run.mcap" not in {command for where, command in COMMANDS if where == page}:
        (tmp_path / "run.mcap").symlink_to(recorded)
    with Reader(shared, tmp_path) as reader:
        for block in blocks(page):
            reader.go_through(block)
