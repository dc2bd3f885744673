"""The vision kernel beside reading the same bytes and beside OpenCV; writes results/vision.json."""

import json
import subprocess
from pathlib import Path

from results import Result, compare, publish

EXECUTABLE = Path(__file__).parents[1] / "build" / "vision" / "bench" / "vision-bench"
SIZES = ("640x480", "800x800", "1280x720", "1920x1080")
REPETITIONS = 15


def medians() -> dict[str, float]:
    """Milliseconds of thread time by benchmark: medians of repetitions in random order."""
    options = {
        "repetitions": REPETITIONS,
        "enable_random_interleaving": "true",
        "report_aggregates_only": "true",
        "min_time": 0.05,
        "format": "json",
    }
    flags = [f"--benchmark_{name}={value}" for name, value in options.items()]
    ended = subprocess.run([EXECUTABLE, *flags], check=True, stdout=subprocess.PIPE, text=True)
    return {
        entry["run_name"]: entry["cpu_time"] * 1e-6
        for entry in json.loads(ended.stdout)["benchmarks"]
        if entry["aggregate_name"] == "median"
    }


def measure() -> list[Result]:
    """Runs the C++ benchmark, on one thread, with frames that stay in the cache as far as they fit."""
    ms = medians()
    results = [
        compare(
            f"masks and components, {size}", ms[f"classify/{size}"], "ms", "sum of its bytes", ms[f"sum/{size}"], most=2
        )
        for size in SIZES
    ]
    pair, tracked, opencv = ms["measure/pair"], ms["track/pair"], ms["opencv/800x800"]
    return [
        *results,
        compare("masks and components, 800x800", ms["classify/800x800"], "ms", "OpenCV chain", opencv, most=1 / 300),
        compare("two frames to four positions", pair, "ms", "sum of both frames' bytes", ms["sum/pair"], most=8),
        compare("the same, markers where expected", tracked, "ms", "sum of both frames' bytes", ms["sum/pair"], most=8),
        compare("two frames to four positions", pair, "ms", "OpenCV chain, both", ms["opencv/pair"], most=1 / 100),
    ]


if __name__ == "__main__":
    publish("vision", measure())
