import subprocess
import sys
from pathlib import Path

import pytest

from armsight.errors import ConfigError
from armsight_sim.settings import argument_parser, parse_settings

EXECUTABLE = Path(sys.executable).parent / "armsight-sim"


@pytest.mark.parametrize(
    "flags",
    [
        ["--fps", "0"],
        ["--fps", "10"],  # the arm would hold between any two commands
        ["--width", "8"],
        ["--height", "100000"],
        ["--ambient", "bright"],
        ["--ambient", "2"],
        ["--noise", "-1"],
        ["--seed", "-1"],
        ["--painters", "-1"],
        ["--painters", "99"],
        ["--model-error", "0.5"],
        ["--model-error", "nan"],
        ["--start-time", "yesterday"],
        ["--start-time", "2024-05-01T12:00:00"],
        ["--start-time", "²"],
        ["--start-time", "99999999999999999999999"],
        ["--start-time", "9999-01-01T00:00:00Z"],
        ["--start-time", "1066-10-14T09:00:00Z"],
    ],
)
def test_values_that_cannot_work_are_refused(flags: list[str]) -> None:
    with pytest.raises(ConfigError, match=flags[0]):
        parse_settings(argument_parser().parse_args(flags))


def test_start_time_is_taken_to_the_nanosecond() -> None:
    text = parse_settings(argument_parser().parse_args(["--start-time", "2024-05-01T12:00:00Z"]))
    assert text.start_ns == 1_714_564_800_000_000_000
    number = parse_settings(argument_parser().parse_args(["--start-time", "1714564800000000001"]))
    assert number.start_ns == 1_714_564_800_000_000_001


@pytest.mark.parametrize(
    "flags", [["--fps", "0"], ["--pose", "9", "0", "0", "0"], ["--connect", "nowhere"], ["--clock", "x"]]
)
def test_process_ends_with_code_2_and_one_line_of_reason(flags: list[str]) -> None:
    ended = subprocess.run([EXECUTABLE, *flags], capture_output=True, text=True, timeout=20, check=False)
    assert ended.returncode == 2
    assert "Traceback" not in ended.stderr
    assert ended.stderr.strip()


@pytest.mark.parametrize(
    "flags",
    [
        ["--external-cameras", "1"],
        ["--external-cameras", "1", "1"],
        ["--external-cameras", "1", "a/b"],
        ["--external-cameras", "1", "2", "--clock", "lockstep"],
        ["--external-cameras", "1", "2", "--target", "visible"],
    ],
)
def test_external_cameras_that_cannot_work_are_refused(flags: list[str]) -> None:
    with pytest.raises(ConfigError, match="--external-cameras"):
        parse_settings(argument_parser().parse_args(flags))


def test_external_cameras_may_come_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ARMSIGHT_EXTERNAL_CAMERAS", "left right")
    assert parse_settings(argument_parser().parse_args([])).external_cameras == ("left", "right")
    flag = ["--external-cameras", "1", "2"]
    assert parse_settings(argument_parser().parse_args(flag)).external_cameras == ("1", "2")
    monkeypatch.setenv("ARMSIGHT_EXTERNAL_CAMERAS", "")
    assert parse_settings(argument_parser().parse_args([])).external_cameras == ()
