"""Inverse kinematics: success and time of the report's descent beside exact solvers; writes results/ik.json."""

import json
import subprocess
import sys
from pathlib import Path

from results import Result, compare, publish

SCRIPT = Path(__file__).parents[1] / "services" / "control" / "bench" / "ik_bench.py"
TARGETS, SEED = 200, 1
PEER = "scipy least_squares"


def measure() -> list[Result]:
    """Runs control's benchmark: solvers interleaved target by target, random reachable targets."""
    command = [sys.executable, str(SCRIPT), "--targets", str(TARGETS), "--seed", str(SEED), "--json", "-"]
    rows = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    peer = next(row for row in rows if row["solver"] == PEER)
    results = []
    for row in rows:
        if row is not peer:
            name = row["solver"]
            # within the report's own tolerance, a mean absolute error of 5 mm
            success, peers = 100 * row["own_tolerance"], 100 * peer["own_tolerance"]
            results.append(compare(f"{name}: success", success, "%", PEER, peers))
            results.append(compare(f"{name}: median time", row["median_ms"], "ms", PEER, peer["median_ms"]))
    return results


if __name__ == "__main__":
    publish("ik", measure())
