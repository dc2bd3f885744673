"""Inverse kinematics: success, time, and behaviour out of reach beside other libraries; writes results/ik.json.

python bench/ik_bench.py                                       # beside pin, mink and scipy
python bench/ik_bench.py --peers roboticstoolbox-python placo  # and others, installed on demand under build/
"""

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from results import Result, at_least, at_most, compare, publish

SCRIPT = Path(__file__).parents[1] / "services" / "control" / "bench" / "ik_bench.py"
TARGETS, SEED = 1000, 1
PEER = "pin"


@dataclass(frozen=True, slots=True)
class Bars:
    """What was promised of one solver; nothing where nothing was."""

    share: str
    """Which success is meant: `success` is within 5 mm, `exact` within 1e-6 m."""
    median_ms: float | None = None
    p99_ms: float | None = None
    batch_ms: float | None = None


BARS: dict[tuple[str, int], Bars] = {
    ("torch", 3): Bars("success", 0.2, 3.0, 50.0),
    ("torch", 4): Bars("success", 1.0, 3.0, 50.0),
    ("levenberg-marquardt", 3): Bars("exact", 2.0, batch_ms=60.0),
    ("levenberg-marquardt", 4): Bars("exact", 2.0, batch_ms=60.0),
    ("closed-form", 3): Bars("exact"),
    ("closed-form", 4): Bars("exact"),
    ("closed-form, the formulas alone", 3): Bars("exact", 0.005, batch_ms=0.3),
}
_EXACT_SOLVERS = ("torch", "levenberg-marquardt", "closed-form")
# Of the exact answer's own: what a micrometre at the tip is worth near a stretched arm.
_MORE_THAN_EXACT_RAD = 0.02


def measure(peers: Sequence[str]) -> list[Result]:
    """Runs control's benchmark: solvers interleaved target by target, random reachable targets."""
    command = [sys.executable, str(SCRIPT), "--targets", str(TARGETS), "--seed", str(SEED), "--json", "-"]
    command += ["--peers", *peers] if peers else []
    rows = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    results = []
    for row in rows:
        beside = next(other for other in rows if (other["solver"], other["joints"]) == (PEER, row["joints"]))
        results += _of(row, beside, rows)
    return results


def _of(row: dict[str, Any], peer: dict[str, Any], rows: Sequence[dict[str, Any]]) -> list[Result]:
    name, bars = f"{row['solver']}, {row['joints']} joints", BARS.get((row["solver"], row["joints"]))
    results = []
    for share, within in (("success", "5 mm"), ("exact", "1 µm")):
        title, value = f"{name}: within {within}", 100 * row[share]
        promised = bars is not None and bars.share == share
        results.append(at_least(title, value, "%", 100) if promised else _beside(title, row, share, "%", peer))
    results.append(_time(f"{name}: median time", row, "median_ms", None if bars is None else bars.median_ms, peer))
    results.append(_time(f"{name}: p99 time", row, "p99_ms", None if bars is None else bars.p99_ms, peer))
    if row["batch_ms"] is not None:
        bar = None if bars is None else bars.batch_ms
        title, value = f"{name}: batch of {TARGETS}", row["batch_ms"]
        results.append(
            Result(title, value, "ms", "", None, "", None) if bar is None else at_most(title, value, "ms", bar)
        )
    if row["above_best_m"] is not None:
        results.append(_beside(f"{name}: out of reach, above the best distance", row, "above_best_m", "m", peer))
        results.append(_step(f"{name}: out of reach, largest step", row, peer, rows))
    return results


def _beside(title: str, row: dict[str, Any], key: str, unit: str, peer: dict[str, Any]) -> Result:
    scale = 100 if unit == "%" else 1
    if row is peer or not peer[key]:
        return Result(title, scale * row[key], unit, "", None, "", None)
    return compare(title, scale * row[key], unit, PEER, scale * peer[key])


def _time(title: str, row: dict[str, Any], key: str, bar: float | None, peer: dict[str, Any]) -> Result:
    return _beside(title, row, key, "ms", peer) if bar is None else at_most(title, row[key], "ms", bar)


def _step(title: str, row: dict[str, Any], peer: dict[str, Any], rows: Sequence[dict[str, Any]]) -> Result:
    if row["solver"] not in _EXACT_SOLVERS:
        return _beside(title, row, "largest_step_rad", "rad", peer)
    exact = next(one for one in rows if (one["solver"], one["joints"]) == ("closed-form", row["joints"]))
    return at_most(title, row["largest_step_rad"], "rad", exact["largest_step_rad"] + _MORE_THAN_EXACT_RAD)


if __name__ == "__main__":
    given = sys.argv[1:]
    publish("ik", measure(given[1:] if given[:1] == ["--peers"] else []))
