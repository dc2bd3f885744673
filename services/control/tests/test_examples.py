"""The examples run as their docstrings say, without bus and simulation."""

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def run(name: str, *arguments: str) -> list[str]:
    command = [sys.executable, name, *arguments]
    done = subprocess.run(command, cwd=EXAMPLES, capture_output=True, text=True, check=True, timeout=240)
    return done.stdout.splitlines()


def test_angles_from_a_csv_of_positions_are_those_that_the_simulator_had() -> None:
    start = ["--start", "-2.0", "-0.35", "1.5", "-1.0"]
    rows = list(csv.DictReader(run("estimate_from_csv.py", "arm.json", "positions.csv", *start)))
    assert len(rows) == 60
    last = np.array([[float(rows[-1][f"joint{i}{what}"]) for i in range(1, 5)] for what in ("", "_sigma")])
    # of the sim that the positions were recorded from, at their last instant
    np.testing.assert_allclose(last[0], [-1.40260, -0.95372, 1.54433, -0.55484], atol=0.02)
    assert (last[1] < 0.02).all()


def test_solving_a_pose_says_what_each_set_of_joints_reaches() -> None:
    near3, near4, low3, low4 = run("solve_a_pose.py")
    assert "3 joints: converged, 0.000 m" in near3
    assert "4 joints: converged, 0.000 m" in near4
    assert "3 joints: unreachable" in low3
    assert "4 joints: converged, 0.000 m" in low4


def test_comparing_solvers_finds_all_of_them_but_the_reports_at_every_target() -> None:
    lines = {line.split()[0]: line for line in run("compare_solvers.py", "6")}
    assert set(lines) == {"torch", "gradient-descent", "levenberg-marquardt", "closed-form"}
    assert all("6 of 6" in line for name, line in lines.items() if name != "gradient-descent")
