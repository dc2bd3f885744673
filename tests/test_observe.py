"""What the operator sees of a running stack: metrics as Prometheus reads them, stages of frames, the doctor's word."""

import json
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import MakeRig
from prometheus_client.openmetrics.parser import text_string_to_metric_families

from rig import SERVICES, Rig

ARMSIGHT = (sys.executable, "-c", "from armsight_operator.cli.app import main; main()")


class Metrics:
    """`armsight metrics` in a process of its own."""

    def __init__(self, rig: Rig) -> None:
        self.process = subprocess.Popen(
            [*ARMSIGHT, "metrics", "--port", "0", "--connect", rig.stack.endpoint], stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().split()[-1]

    def scrape(self) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
        request = urllib.request.Request(self.url, headers={"Accept": "application/openmetrics-text"})  # noqa: S310
        with urllib.request.urlopen(request, timeout=5) as answer:  # noqa: S310
            assert answer.headers["Content-Type"].startswith("application/openmetrics-text")
            text = answer.read().decode()
        return {
            (sample.name.removeprefix("armsight_"), tuple(sorted(sample.labels.items()))): sample.value
            for family in text_string_to_metric_families(text)  # type: ignore[no-untyped-call]
            for sample in family.samples
        }

    def __call__(self, name: str, **labels: str) -> float:
        return self.scrape().get((name, tuple(sorted(labels.items()))), 0.0)


@pytest.fixture
def watched(make_rig: MakeRig) -> Iterator[tuple[Rig, Metrics]]:
    """A stack that holds, and somebody who watches it from the start."""
    rig = make_rig(target="none", mode="hold", fps=15)
    rig.start("router")
    metrics = Metrics(rig)
    rig.start_all()
    rig.wait_ready()
    yield rig, metrics
    metrics.process.kill()
    metrics.process.wait()


def test_a_scrape_tells_of_death_return_and_refusal(watched: tuple[Rig, Metrics]) -> None:
    rig, metrics = watched

    def up(name: str) -> float:
        return metrics("service_up", service=name)

    rig.wait_until(lambda: all(up(name) for name in SERVICES), 10, "all are up")
    rig.wait_until(lambda: metrics("stage_latency_seconds_count", stage="frame_to_command") > 5, 10, "frames are timed")
    mean_s = metrics("stage_latency_seconds_sum", stage="vision") / metrics(
        "stage_latency_seconds_count", stage="vision"
    )
    assert 0 < mean_s < 5
    # a command that answers an instant of 5 s ago
    before = metrics("refused_total", service="sim", what="command", reason="stale")
    rig.put_command({}, age_s=5.0)
    rig.wait_until(
        lambda: metrics("refused_total", service="sim", what="command", reason="stale") == before + 1,
        5,
        "the refused command is counted with its reason",
    )
    # vision dies, and comes back as another process
    measured = metrics("frames_total", service="vision", step="measured")
    assert measured > 0
    rig.kill("vision")
    rig.wait_until(lambda: up("vision") == 0, 5, "vision is down")
    assert up("sim") == up("control") == 1
    assert metrics("frames_total", service="vision", step="measured") >= measured
    rig.start("vision")
    rig.wait_ready()
    rig.wait_until(lambda: up("vision") == 1, 10, "vision is up again")
    assert metrics("service_restarts_total", service="vision") == 1
    rig.wait_until(
        lambda: metrics("frames_total", service="vision", step="measured") > measured, 10, "its totals go on"
    )
    # the router dies, and comes back
    rig.kill("router")
    rig.wait_until(lambda: metrics("bus_connected") == 0, 5, "the exporter says that it hears nothing")
    rig.start("router")
    rig.wait_until(lambda: metrics("bus_connected") == 1 and up("sim") == 1, 10, "it hears again")
    began = time.monotonic()
    metrics.process.terminate()
    assert metrics.process.wait(timeout=5) == 0
    assert time.monotonic() - began < 2.0


def test_stages_of_a_frame_add_up_and_the_doctor_is_content(running: Rig, tmp_path: Path) -> None:
    file = tmp_path / "frames.json"
    connect = ("--connect", running.stack.endpoint)
    traced = subprocess.run(
        [*ARMSIGHT, "trace", "--frames", "10", "--json", "--chrome", str(file), *connect],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert traced.returncode == 0, traced.stderr
    *frames, last = [json.loads(line) for line in traced.stdout.splitlines()]
    assert len(frames) == last["summary"]["frames"] == 10
    assert last["summary"]["contradicted"] == 0
    for frame in frames:
        took = frame["ms"]
        parts = [took[name] for name in ("frames", "vision", "positions", "control")]
        assert all(part >= 0 for part in parts)
        assert sum(parts) == pytest.approx(took["frame_to_command"], abs=0.001)
    assert sum(event["ph"] == "X" for event in json.loads(file.read_text())["traceEvents"]) >= 40
    examined = subprocess.run(
        [*ARMSIGHT, "doctor", "--json", *connect], capture_output=True, text=True, timeout=120, check=False
    )
    checks = {one["check"]: one for one in json.loads(examined.stdout)["checks"]}
    assert examined.returncode == 0, examined.stdout
    # what this very stack needed to run, and a disk or a clock may be no better than it is
    for name in ("router", "graphics", "vision", "zenoh", f"port {running.stack.port}"):
        assert checks[name]["level"] == "ok", checks[name]
    assert not any(
        "heard of" in checks[name]["found"] for name in SERVICES
    )  # a busy machine's are degraded, and say why
    assert checks["solvers"]["level"] in ("ok", "warning")
