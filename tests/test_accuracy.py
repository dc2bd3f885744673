"""What vision reaches where nothing but its own mathematics limits it."""

import json
import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).parents[1] / "bench" / "floating_spheres.py"


def test_centres_of_whole_spheres_are_a_hundredth_of_a_pixel_exact() -> None:
    run = subprocess.run(
        [sys.executable, str(SCRIPT), "20", "10"], capture_output=True, text=True, timeout=240, check=False
    )
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout)
    assert found["samples"] > 40
    assert found["mean_px"] < 0.01
    assert found["p99_px"] < 0.1
