"""How exact the whole pipeline is: `armsight report` in several kinds of light; writes results/accuracy.json.

The poses come from a seed that nobody looks at while developing: another one each time that vision or control change.
"""

import argparse
import csv
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from armsight_operator.report.markers import CHI2_95
from results import Result, at_most, between, publish

ROOT = Path(__file__).parents[1]
SEED = 15923
POSES = 1000
ALONE_POSES = 100
MOVED = 1000
VARIANTS = {
    "4 samples": [],
    "no multisampling": ["--samples", "0"],
    "4 samples, noise 4": ["--noise", "4"],
    "4 samples, noise 4, light 0.1 to 0.7": ["--noise", "4", "--ambient", "sweep"],
    "4 samples, emissive markers": ["--markers", "emissive"],
}
STANDS_STILL = "green"  # one error in every frame: only moved cameras tell whether its covariance is honest
UNPROMISED = "no multisampling"  # what real time draws, for comparison
# What was promised, of frames with 4 samples a pixel.
TABLE1_MSE_M2, MEAN_MM, P99_MM, P99_HIDDEN_MM = 5e-6, 3.0, 12.0, 50.0
HONEST = (0.88, 0.99)
ALONE_PX = 0.01


def reported(folder: Path, flags: list[str]) -> dict[str, Any]:
    """The figures of one report."""
    command = [str(Path(sys.executable).parent / "armsight"), "report", "--out", str(folder)]
    command += ["--poses", str(POSES), "--seed", str(SEED), *flags]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    return summary


def within(folder: Path) -> dict[str, float]:
    """By marker that moves: the share of positions in random poses that lie within 95 % of their covariance."""
    inside: dict[str, list[bool]] = {}
    with (folder / "markers.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if row["lost"] == "0" and row["test"] == "random" and row["marker"] != STANDS_STILL:
                inside.setdefault(row["marker"], []).append(float(row["d2"]) < CHI2_95)
    return {marker: sum(flags) / len(flags) for marker, flags in sorted(inside.items())}


def figures(name: str, folder: Path, summary: dict[str, Any]) -> list[Result]:
    """One variant's lines; bars where they were promised for it."""
    seen = summary["random"]["markers"]
    results = [
        at_most(f"{name}: table 1, MSE of the end effector", summary["table1"]["mse"], "m²", TABLE1_MSE_M2),
        at_most(f"{name}: markers seen to 50 % by both, mean", 1000 * seen["visible_50"]["mean"], "mm", MEAN_MM),
        at_most(f"{name}: markers seen to 50 % by both, p99", 1000 * seen["visible_50"]["p99"], "mm", P99_MM),
        at_most(f"{name}: markers seen to 10 % by both, p99", 1000 * seen["visible_10"]["p99"], "mm", P99_HIDDEN_MM),
    ]
    for marker, share in within(folder).items():
        results.append(between(f"{name}: {marker} within its 95 %", share, "", *HONEST))
    tests = [summary["part1"]["markers"], summary["part2"]["markers"]]
    wrong = sum(test["wrong"] for test in tests)
    frames = sum(test["samples"] for test in tests)
    results.append(at_most(f"{name}: wrong and denied it, of {frames} in both motions", wrong, "", 0))
    if name == UNPROMISED:
        return [replace(result, bar="", holds=None) for result in results]
    return results


def alone() -> Result:
    """The markers with nothing in the way, drawn finer and averaged down."""
    script = Path(__file__).with_name("floating_spheres.py")
    command = [sys.executable, str(script), str(SEED), str(ALONE_POSES)]
    found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    name = f"nothing hidden, drawn 3 x as fine, mean of {found['samples']} centres"
    return at_most(name, found["mean_px"], "px", ALONE_PX)


def moved() -> list[Result]:
    """Whether every marker's covariance is honest, with other places of the cameras for every pose."""
    script = Path(__file__).with_name("moved_cameras.py")
    command = [sys.executable, str(script), str(SEED), str(MOVED)]
    found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    results = [
        between(f"cameras moved: {m} within its 95 %", share, "", *HONEST) for m, share in found["within"].items()
    ]
    return [*results, at_most(f"cameras moved: wrong and denied it, of {found['samples']}", found["wrong"], "", 0)]


def main() -> None:
    """Runs every variant, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("variants", nargs="*", metavar="VARIANT", help=f"one of {list(VARIANTS)}; default: all")
    wanted = parser.parse_args().variants or list(VARIANTS)
    results: list[Result] = []
    for name in wanted:
        flags = VARIANTS[name]
        folder = ROOT / "build" / "bench" / name.replace(" ", "-").replace(",", "")
        results += figures(name, folder, reported(folder, flags))
    publish("accuracy", [*results, *moved(), alone()])


if __name__ == "__main__":
    main()
