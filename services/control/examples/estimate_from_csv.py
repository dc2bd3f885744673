"""Joint angles from a CSV of marker positions, without the bus.

    python estimate_from_csv.py arm.json positions.csv --start 0 0 0.5 -0.4 > angles.csv

``arm.json`` is an ArmDescription as protobuf writes it in JSON. A row of the CSV is one marker at one instant: capture
time in ns, name, position in the world frame (m) and the upper triangle of its covariance (m²); a marker that nobody
sees at an instant has no row. ``--start`` says roughly where the arm is at the first instant: its twin looks the same.
"""

import argparse
import csv
import sys
from itertools import groupby
from pathlib import Path

import numpy as np
from google.protobuf import json_format

from armsight.v1.description_pb2 import ArmDescription
from armsight_control import AllJoints, Arm, Positions, SeenMarker, Track, arm_of

UPPER = ("xx", "xy", "xz", "yy", "yz", "zz")


def seen_marker(row: dict[str, str], arm: Arm) -> SeenMarker:
    """One row, in the base frame."""
    xx, xy, xz, yy, yz, zz = (float(row[name]) for name in UPPER)
    covariance = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return SeenMarker(
        position=arm.world_to_base(np.array([float(row[axis]) for axis in "xyz"])),
        covariance=arm.R_world_base.T @ covariance @ arm.R_world_base,
        one_view=False,
    )


def main() -> None:
    """Reads, estimates instant by instant, writes."""
    parser = argparse.ArgumentParser(description="Joint angles from a CSV of marker positions.")
    parser.add_argument("arm", type=Path, help="ArmDescription as JSON")
    parser.add_argument("positions", type=Path, help="CSV of markers, ordered by capture time")
    parser.add_argument("--start", type=float, nargs="+", required=True, help="rad, one for each joint")
    given = parser.parse_args()
    arm = arm_of(json_format.Parse(given.arm.read_text(encoding="utf-8"), ArmDescription()))
    if len(given.start) != arm.chain.count:
        parser.error(f"--start has {len(given.start)} angles; this arm needs {', '.join(arm.chain.names)}")
    estimator, start = AllJoints(arm), np.array(given.start)
    track: Track | None = None
    out = csv.writer(sys.stdout)
    out.writerow(["capture_ns", *arm.chain.names, *(f"{name}_sigma" for name in arm.chain.names)])
    with given.positions.open(encoding="utf-8", newline="") as file:
        for capture, rows in groupby(csv.DictReader(file), key=lambda row: int(row["capture_ns"])):
            markers = {row["marker"]: seen_marker(row, arm) for row in rows}
            outcome = estimator.step(track, Positions(capture, markers), start)
            track, estimate = outcome.track, outcome.estimate
            out.writerow([capture, *(f"{value:.6f}" for value in (*estimate.angles, *outcome.sigma))])


if __name__ == "__main__":
    main()
