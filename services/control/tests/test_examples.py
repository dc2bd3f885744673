"""The examples run as their docstrings say."""

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def test_angles_from_a_csv_of_positions_are_those_that_the_simulator_had() -> None:
    command = [sys.executable, "estimate_from_csv.py", "arm.json", "positions.csv"]
    start = ["--start", "-2.0", "-0.35", "1.5", "-1.0"]
    done = subprocess.run([*command, *start], cwd=EXAMPLES, check=True, capture_output=True, text=True, timeout=60)
    rows = list(csv.DictReader(done.stdout.splitlines()))
    assert len(rows) == 60
    last = np.array([[float(rows[-1][f"joint{i}{what}"]) for i in range(1, 5)] for what in ("", "_sigma")])
    # of the sim that the positions were recorded from, at their last instant
    np.testing.assert_allclose(last[0], [-1.40260, -0.95372, 1.54433, -0.55484], atol=0.02)
    assert (last[1] < 0.02).all()
