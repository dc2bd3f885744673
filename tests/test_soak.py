"""Half an hour of tracking: nothing grows, nothing gets slower, no frame goes unanswered."""

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from armsight import topics
from armsight.bus import Received
from armsight.times import from_timestamp
from armsight.v1.joints_pb2 import JointCommand
from rig import SERVICES, Rig

SECONDS = 1800
WARM_S = 120
EVERY_S = 5.0
GROWTH_MIB_AN_HOUR = 4.0
"""Of memory, by a line through what was measured: below what allocators do by themselves in half an hour."""
DRIFT_MS_AN_HOUR = 2.0
"""Of the median time from frames to command."""

Series = Sequence[float] | npt.NDArray[np.float64]

pytestmark = [pytest.mark.long, pytest.mark.timeout(SECONDS + 600)]


def test_half_an_hour_leaves_no_trace(tracking: Rig) -> None:
    captured: dict[int, float] = {}
    answered: dict[int, float] = {}
    processes = {name: tracking.stack.process(name) for name in ("router", *SERVICES)}
    pids = {name: process.pid for name, process in processes.items() if process is not None}
    tracking.wait_until(tracking.moving, 20, "the arm moves")
    before = tracking.instances()
    tracking.pause(WARM_S)
    tracking.bus.subscriber(
        topics.CLOCK, keep=64, on_message=lambda got: captured.update({from_timestamp(got.message.capture_time): 0.0})
    )

    def heard(got: Received[JointCommand]) -> None:
        stages = got.message.stages
        answered[from_timestamp(got.message.answers)] = (stages.control_sent_ns - stages.frames_sent_ns) / 1e6

    tracking.bus.subscriber(topics.JOINT_COMMAND, keep=64, on_message=heard)
    began = time.monotonic()
    at: list[float] = []
    memory: dict[str, list[float]] = {name: [] for name in pids}
    descriptors: dict[str, list[int]] = {name: [] for name in pids}
    while (passed := time.monotonic() - began) < SECONDS:
        at.append(passed / 3600)
        for name, pid in pids.items():
            memory[name].append(private_mib(pid))
            descriptors[name].append(len(list(Path(f"/proc/{pid}/fd").iterdir())))
        tracking.pause(EVERY_S)
    # the first and the last may have been on their way
    stamps = sorted(captured)[30:-30]
    unanswered = [stamp for stamp in stamps if stamp not in answered]
    latencies = [answered[stamp] for stamp in stamps if stamp in answered]
    growth = {name: slope(at, values) for name, values in memory.items()}
    hours = np.linspace(0.0, at[-1], len(latencies))
    drift = slope(*by_minute(hours, latencies))
    for name in pids:
        print(
            f"{name}: {memory[name][-1]:.1f} MiB, {growth[name]:+.2f} MiB an hour; "
            f"{descriptors[name][-1]} descriptors, {descriptors[name][0]} at the beginning"
        )
    print(f"{len(stamps)} frames, {len(unanswered)} unanswered; frames to command {np.median(latencies):.2f} ms in the")
    print(f"middle, p99 {np.percentile(latencies, 99):.2f} ms, {drift:+.2f} ms an hour")
    assert tracking.instances() == before
    assert unanswered == []
    assert {name: rate for name, rate in growth.items() if rate > GROWTH_MIB_AN_HOUR} == {}
    assert all(values[-1] <= max(values[:10]) for values in descriptors.values())
    assert drift < DRIFT_MS_AN_HOUR


def private_mib(pid: int) -> float:
    """Of memory that is the process' own."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii").splitlines()
    kilobytes = sum(int(line.split()[1]) for line in lines if line.startswith(("Private_Clean", "Private_Dirty")))
    return kilobytes / 1024


def by_minute(hours: Series, values: Series) -> tuple[Series, Series]:
    """Medians of each minute: one slow frame is no drift."""
    number = np.floor(np.asarray(hours) * 60).astype(int)
    kept = np.unique(number)
    return list(kept / 60), [float(np.median(np.asarray(values)[number == minute])) for minute in kept]


def slope(hours: Series, values: Series) -> float:
    """Of the line through the points that half of all pairs lie above (Theil and Sen): outliers don't bend it."""
    x, y = np.asarray(hours, dtype=float), np.asarray(values, dtype=float)
    i, j = np.triu_indices(len(x), 1)
    return float(np.median((y[j] - y[i]) / (x[j] - x[i])))
