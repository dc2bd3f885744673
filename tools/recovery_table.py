"""Writes the table of measured recoveries into docs/reliability.md: `.venv/bin/python tools/recovery_table.py`.

The suites measure: `ARMSIGHT_RECOVERY_RESULTS=bench/results/recovery.json .venv/bin/pytest tests/test_faults.py
tests/test_network_faults.py` adds to that file, with `-m long` fifty of each.
"""

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "bench" / "results" / "recovery.json"
PAGE = ROOT / "docs" / "reliability.md"
BEGIN = "## Measured\n"


def table(results: list[dict[str, Any]]) -> str:
    """A line for each fault and victim; seconds, the worst of all, and how many there were."""
    by_fault: defaultdict[tuple[str, str], list[dict[str, Any]]] = defaultdict(list)
    for each in results:
        by_fault[each["fault"], each["victim"]].append(each)
    lines = [
        "| fault | of | times | start-up, longest | moves again after, longest |",
        "|---|---|---|---|---|",
    ]
    for (fault, victim), times in by_fault.items():
        start_up, recovery = (max(one[name] for one in times) for name in ("start_up_s", "recovery_s"))
        started = f"{start_up:.2f} s" if start_up else "–"
        lines.append(f"| {fault} | {victim} | {len(times)} | {started} | {recovery:.2f} s |")
    return "\n".join([*lines, ""])


def page(before: str, results: list[dict[str, Any]]) -> str:
    """The page with its last section made anew."""
    head = before.partition(BEGIN)[0]
    return (
        f"{head}{BEGIN}\nMade by `tools/recovery_table.py` from `bench/results/recovery.json`, on two "
        "cores that had other work, too. "
        "Start-up is from the start of the process to its word that it is well (of the router: until it listens);"
        "\nwhat comes after is counted from there, and from SIGCONT where a process stood still, and from "
        "the end of a fault of the network. "
        f"0.00 where the arm moved before that word was heard.\n\n{table(results)}"
    )


if __name__ == "__main__":
    known = json.loads(RESULTS.read_text(encoding="utf-8"))
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), known), encoding="utf-8")
