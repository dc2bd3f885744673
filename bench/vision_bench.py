"""The vision kernel beside reading the same bytes and beside OpenCV; writes results/vision.json."""

import json
import subprocess
from pathlib import Path

from results import Result, compare, publish

EXECUTABLE = Path(__file__).parents[1] / "build" / "vision" / "bench" / "vision-bench"


def measure() -> list[Result]:
    """Runs the C++ benchmark: medians of interleaved runs, thread CPU time, 800 x 800 frames."""
    ended = subprocess.run([EXECUTABLE], check=True, capture_output=True, text=True)
    times = {name: figures["p50_ms"] for name, figures in json.loads(ended.stdout).items()}
    return [
        Result("reading one frame's bytes", times["read"], "ms", "", None, "", None),
        compare("masks and components, one frame", times["classify"], "ms", "reading the frame", times["read"]),
        compare("masks and components, one frame", times["classify"], "ms", "OpenCV float chain", times["opencv"]),
        compare("two frames to four positions", times["pair"], "ms", "reading both frames", 2 * times["read"]),
        compare("two frames to four positions", times["pair"], "ms", "OpenCV masks of both", 2 * times["opencv"]),
    ]


if __name__ == "__main__":
    publish("vision", measure())
