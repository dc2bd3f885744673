"""Frames as trace events, the JSON that chrome://tracing and Perfetto open."""

import json
from collections.abc import Iterable, Iterator
from typing import Any

from armsight_operator.trace.stages import STAGES, Frame

_PROCESS = 1
_ROWS = {name: row for row, name in enumerate(("sim", "bus", "vision", "control"), start=1)}


def trace_events(frames: Iterable[Frame], began_ns: int) -> Iterator[dict[str, Any]]:
    """Complete events, a row for each service and one for the bus; microseconds since ``began_ns``."""
    yield {"ph": "M", "name": "process_name", "pid": _PROCESS, "tid": 0, "args": {"name": "armsight"}}
    for name, row in _ROWS.items():
        yield {"ph": "M", "name": "thread_name", "pid": _PROCESS, "tid": row, "args": {"name": name}}
    for frame in frames:
        for stage in STAGES:
            took = frame.seconds(stage)
            if took is None:
                continue
            yield {
                "ph": "X",
                "name": stage.what,
                "cat": "heard" if stage.heard else "stamped",
                "pid": _PROCESS,
                "tid": _ROWS[stage.who],
                "ts": (frame.instants[stage.begin] - began_ns) / 1e3,
                "dur": took * 1e6,
                "args": {"capture_time_ns": str(frame.capture_ns)},
            }


def chrome_trace(frames: Iterable[Frame]) -> str:
    """The whole file; times begin with the first frame."""
    kept = list(frames)
    began_ns = min((ns for frame in kept for ns in frame.instants.values()), default=0)
    return json.dumps({"displayTimeUnit": "ms", "traceEvents": list(trace_events(kept, began_ns))})
