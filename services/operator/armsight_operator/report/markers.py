"""How far measured marker centres are from the truth, and whether their covariances and statuses say so."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from armsight.v1.joints_pb2 import MARKER_STATUS_LOST, JointPositions
from armsight_operator.report.chain import Arm, Array

CHI2_95 = 7.81
"""95 % of squared normalised errors of three normal variables lie below it."""

WRONG_D2 = 50.0
WRONG_M = 0.020
"""A position is wrong when it is this far off and its covariance denies it this much."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One marker at one instant."""

    marker: str
    lost: bool
    error_m: float
    d2: float
    """Squared error, normalised by the covariance: chi squared with three degrees of freedom if that is honest."""
    visible: float
    """Share of the disc in the view that sees less of it, as vision tells; 0 unless all cameras see it."""

    @property
    def wrong(self) -> bool:
        """Neither lost nor right nor doubtful."""
        return not self.lost and self.d2 > WRONG_D2 and self.error_m > WRONG_M


def samples_of(arm: Arm, positions: JointPositions, q: Array, cameras: int) -> list[Sample]:
    """All markers of one instant beside the true pose ``q``."""
    samples = []
    for measured in positions.markers:
        if measured.name not in arm.markers:  # a body beside the arm
            continue
        lost = measured.status == MARKER_STATUS_LOST or not measured.HasField("position")
        error, d2 = float("nan"), float("nan")
        if not lost:
            truth = arm.to_world(arm.point(q, arm.markers[measured.name]))
            p = measured.position
            apart = np.array([p.x, p.y, p.z]) - truth
            covariance = np.array(measured.covariance).reshape(3, 3)
            error, d2 = float(np.linalg.norm(apart)), float(apart @ np.linalg.solve(covariance, apart))
        shares = [observation.visible for observation in measured.observations]
        visible = min(shares) if len(shares) == cameras else 0.0
        samples.append(Sample(measured.name, lost, error, d2, visible))
    return samples


def write_csv(samples: Mapping[str, Sequence[Sample]], file: Path) -> None:
    """All samples, test by test, for whoever wants to look closer."""
    with file.open("w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(["test", "marker", "lost", "error_m", "d2", "visible"])
        for test, rows in samples.items():
            for s in rows:
                writer.writerow([test, s.marker, int(s.lost), f"{s.error_m:.6f}", f"{s.d2:.3f}", f"{s.visible:.3f}"])


def figures(samples: Sequence[Sample]) -> dict[str, Any]:
    """What a run's samples add up to; metres."""
    seen = [sample for sample in samples if not sample.lost]
    by_marker = {
        name: float(np.mean([s.d2 < CHI2_95 for s in seen if s.marker == name]))
        for name in sorted({s.marker for s in seen})
    }
    return {
        "samples": len(samples),
        "lost": len(samples) - len(seen),
        "wrong": sum(sample.wrong for sample in samples),
        "visible_50": _errors([s for s in seen if s.visible >= 0.5]),
        "visible_10": _errors([s for s in seen if s.visible >= 0.1]),
        "within_chi2_95": by_marker,
    }


def _errors(samples: Sequence[Sample]) -> dict[str, float]:
    if not samples:
        return {"samples": 0}
    errors = np.array([sample.error_m for sample in samples])
    return {
        "samples": len(errors),
        "mean": float(errors.mean()),
        "p99": float(np.percentile(errors, 99)),
        "max": float(errors.max()),
    }
