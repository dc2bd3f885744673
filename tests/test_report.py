"""`armsight report`: the figures that the project promises, through the real pipeline."""

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from armsight_operator.stack.executables import find_executable

pytestmark = pytest.mark.untimed

SEED = 90125  # of the random poses; used nowhere in development


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("report")
    flags = ["--quick", "--poses", "40", "--seed", str(SEED), "--out", str(out)]
    subprocess.run([str(find_executable("router")), "report", *flags], check=True)
    return out


@pytest.fixture(scope="module")
def summary(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    return found


def test_end_effector_of_the_ten_poses_is_within_the_bar(summary: dict[str, Any]) -> None:
    assert len(summary["table1"]["rows"]) == 10
    assert summary["table1"]["mse"] <= 5e-4


def test_report_method_on_our_frames_is_as_wrong_as_it_was_measured(summary: dict[str, Any]) -> None:
    # 0.156 to 0.160 were measured before this was written: a peer that came out better or worse would be another method
    assert 0.15 < summary["table1"]["report_method_mse"] < 0.165


@pytest.mark.parametrize(
    ("part", "joints"),
    [
        ("part1", ("nu", "phi", "psi")),
        ("part2", ("theta", "phi", "psi")),
        ("all", ("theta", "nu", "phi", "psi")),
    ],
)
def test_angles_of_every_test_are_within_the_bar(summary: dict[str, Any], part: str, joints: tuple[str, ...]) -> None:
    figures = summary[part]
    for joint in joints:
        assert figures["observable"][joint] > 0.5, joint
        assert figures["rms"][joint] <= 0.005, joint
        assert figures["max"][joint] <= 0.03, joint


def test_random_poses_are_measured_without_wild_values(summary: dict[str, Any]) -> None:
    assert summary["random"]["poses"] == 40
    assert summary["random"]["mean"] < 0.03


def test_latency_and_inverse_kinematics_are_told(summary: dict[str, Any]) -> None:
    assert 0 < summary["latency_ms"]["p50"] <= summary["latency_ms"]["p99"]
    assert set(summary["ik"]) == {"fixed", "previous", "random"}
    assert all(0 <= start["share"] <= 1 for start in summary["ik"].values())


def test_pictures_and_markdown_are_written(folder: Path) -> None:
    pictures = {f"{test}_{what}.png" for test in ("part1", "part2", "all") for what in ("angles", "errors")}
    names = {"report.md", "table1.png", *pictures}
    assert names | {"report.html"} <= {file.name for file in folder.iterdir()}
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.count('src="data:image/png;base64,') == len(pictures) + 1
    assert ".png" not in page
    text = (folder / "report.md").read_text(encoding="utf-8")
    assert all(name in text for name in names - {"report.md"})
