"""The figures as JSON and as Markdown."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from armsight_operator.report import markers
from armsight_operator.report.chain import Array
from armsight_operator.report.measure import Descent, Part, PoseRow, Random, mean_squared

REPORT_MSE = 0.155
"""Of the report's own table, m²."""

TITLES = {"part1": "Part I: joint 1 fixed", "part2": "Part II: joint 2 fixed", "all": "All joints at once"}
"""Of the test motions."""


@dataclass(slots=True)
class Results:
    """Everything that one run of the report measured."""

    samples: int
    quick: bool
    table1: list[PoseRow]
    parts: dict[str, Part]
    """By the keys of :data:`TITLES`."""
    descents: list[Descent]
    latencies_ms: Array
    random: Random | None = None


def to_json(results: Results) -> dict[str, Any]:
    """What ``summary.json`` holds; metres, radians, milliseconds."""
    rows = results.table1
    summary: dict[str, Any] = {
        "samples": results.samples,
        "quick": results.quick,
        "table1": {
            "mse": mean_squared(_errors(rows)),
            "report_mse": REPORT_MSE,
            "report_method_mse": mean_squared(np.array([row.report_method - row.truth for row in rows])),
            "rows": [_row(row) for row in rows],
        },
        **{key: part_figures(part) for key, part in results.parts.items()},
        "ik": {
            descent.initialisation: {
                "targets": descent.targets,
                "converged": descent.converged,
                "share": descent.converged / descent.targets,
            }
            for descent in results.descents
        },
        "latency_ms": latency_figures(results.latencies_ms),
    }
    if results.random is not None:
        distance = np.linalg.norm(results.random.error, axis=1)
        summary["random"] = {
            "seed": results.random.seed,
            "poses": len(distance),
            "mse": mean_squared(results.random.error),
            "mean": float(distance.mean()),
            "p99": float(np.percentile(distance, 99)),
            "markers": markers.figures(results.random.markers),
        }
    return summary


def to_markdown(results: Results) -> str:
    """The same for people."""
    summary = to_json(results)
    table = summary["table1"]
    rendering = "4 samples a pixel" if results.samples else "no multisampling"
    peers = f"the report {REPORT_MSE}; its method on these frames {table['report_method_mse']:.3g}"
    lines = [
        "# armsight report",
        "",
        f"Whole pipeline in lockstep, {rendering}: frames, bus, vision, control.",
        "",
        "## End effector in ten poses",
        "",
        "Base frame, metres; errors against K of the true angles.",
        "",
        "| θ | ϕ | ψ | measured | K(q) | error, mm | the report, mm | its method here, mm |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in results.table1:
        ours, theirs, method = (
            1000 * float(np.linalg.norm(point - row.truth))
            for point in (row.measured, row.report_measured, row.report_method)
        )
        lines.append(
            f"| {row.theta:g} | {row.phi:g} | {row.psi:g} | {_point(row.measured)} | {_point(row.truth)} "
            f"| {ours:.1f} | {theirs:.0f} | {method:.0f} |"
        )
    lines += [
        "",
        f"MSE **{table['mse']:.2g} m²**; {peers}.",
        "",
        "![end effector error](table1.png)",
        "",
    ]
    for key, title in TITLES.items():
        lines += [f"## {title}", "", *part_lines(key, summary[key])]
    lines += [
        "## Inverse kinematics: the report's gradient descent",
        "",
        "| start | targets | converged |",
        "|---|---|---|",
    ]
    lines += [f"| {d.initialisation} | {d.targets} | {100 * d.converged / d.targets:.0f} % |" for d in results.descents]
    if results.random is not None:
        r = summary["random"]
        lines += [
            "",
            f"## {r['poses']} random poses (seed {r['seed']})",
            "",
            f"End effector: mean {1000 * r['mean']:.1f} mm, p99 {1000 * r['p99']:.1f} mm, MSE {r['mse']:.2g} m².",
            "",
            *_marker_lines(r["markers"]),
        ]
    lines += ["", *latency_lines(summary["latency_ms"])]
    return "\n".join(lines)


def part_lines(key: str, part: dict[str, Any]) -> list[str]:
    """One motion's tables and plots; its plots are named by the key."""
    return [
        "| joint | RMS, mrad | max, mrad | observable |",
        "|---|---|---|---|",
        *(
            f"| {symbol} | {1000 * part['rms'][symbol]:.1f} | {1000 * part['max'][symbol]:.1f} "
            f"| {100 * part['observable'][symbol]:.0f} % |"
            for symbol in part["rms"]
        ),
        "",
        f"![angles]({key}_angles.png)",
        "",
        f"![errors]({key}_errors.png)",
        "",
        *_marker_lines(part["markers"]),
    ]


def latency_figures(latencies_ms: Array) -> dict[str, float]:
    """Frames sent to command sent."""
    return {"p50": float(np.percentile(latencies_ms, 50)), "p99": float(np.percentile(latencies_ms, 99))}


def latency_lines(latency: dict[str, float]) -> list[str]:
    """The same for people."""
    return [
        "## Latency",
        "",
        f"Frames sent to command sent: p50 {latency['p50']:.1f} ms, p99 {latency['p99']:.1f} ms.",
        "",
    ]


def _marker_lines(told: dict[str, Any]) -> list[str]:
    def error(key: str) -> str:
        e = told[key]
        return (
            f"mean {1000 * e['mean']:.1f}, p99 {1000 * e['p99']:.1f}, max {1000 * e['max']:.0f}"
            if e["samples"]
            else "-"
        )

    honest = ", ".join(f"{name} {100 * share:.0f} %" for name, share in told["within_chi2_95"].items())
    return [
        "| markers | |",
        "|---|---|",
        f"| error where all cameras see 50 % or more, mm | {error('visible_50')} |",
        f"| error where all see 10 % or more, mm | {error('visible_10')} |",
        f"| within the 95 % of their own covariance | {honest} |",
        f"| lost, of {told['samples']} | {told['lost']} |",
        f"| wrong: over {1000 * markers.WRONG_M:.0f} mm, and the covariance denies it | {told['wrong']} |",
        "",
    ]


def part_figures(part: Part) -> dict[str, Any]:
    """Of one motion: radians and metres; what can't be observed doesn't count."""
    rms, worst, share = {}, {}, {}
    for index, symbol in enumerate(part.symbols):
        counted = part.error[part.observable[:, index], index]
        rms[symbol] = float(np.sqrt(np.mean(counted**2))) if counted.size else float("nan")
        worst[symbol] = float(np.abs(counted).max()) if counted.size else float("nan")
        share[symbol] = float(part.observable[:, index].mean())
    return {
        "rms": rms,
        "max": worst,
        "observable": share,
        "frames": len(part.time_s),
        "markers": markers.figures(part.markers),
    }


def _row(row: PoseRow) -> dict[str, Any]:
    return {
        "theta": row.theta,
        "phi": row.phi,
        "psi": row.psi,
        "measured": row.measured.tolist(),
        "truth": row.truth.tolist(),
        "mse": mean_squared(row.measured - row.truth),
        "report_measured": row.report_measured.tolist(),
        "report_mse": mean_squared(row.report_measured - row.truth),
        "report_method": row.report_method.tolist(),
        "report_method_mse": mean_squared(row.report_method - row.truth),
    }


def _errors(rows: list[PoseRow]) -> Array:
    return np.array([row.measured - row.truth for row in rows])


def _point(point: Array) -> str:
    return f"({', '.join(f'{value:.3f}' for value in point)})"
