import time
from collections.abc import Callable

import pytest

from armsight import topics
from armsight.bus import Bus
from armsight.v1.health_pb2 import HEALTH_STATUS_DEGRADED, HEALTH_STATUS_WAITING
from armsight.v1.safety_pb2 import STOP_ACTION_STOP, StopRequest
from armsight_operator import monitor as module
from armsight_operator.cli.status import live_line
from armsight_operator.monitor import Monitor, Snapshot
from fake_arm import FakeArm


@pytest.fixture
def monitor(make_bus: Callable[[], Bus], arm: FakeArm) -> Monitor:
    monitor = Monitor(make_bus())
    arm.wait_for_listeners()
    return monitor


def await_snapshot(monitor: Monitor, condition: Callable[[Snapshot], bool]) -> Snapshot:
    until = time.monotonic() + 5.0
    while not condition(snapshot := monitor.snapshot()):
        assert time.monotonic() < until, snapshot
        time.sleep(0.01)
    return snapshot


def test_a_service_that_was_never_heard_of_is_missing(monitor: Monitor) -> None:
    snapshot = monitor.snapshot()
    assert [(s.name, s.status) for s in snapshot.services] == [(n, "missing") for n in ("sim", "vision", "control")]
    assert not snapshot.ready
    assert not snapshot.works
    assert snapshot.mode == ""
    assert snapshot.error_m is None
    assert snapshot.latency_p50_ms is None


def test_ready_when_all_three_are_well(monitor: Monitor, arm: FakeArm) -> None:
    for name in ("sim", "vision"):
        arm.say_health(name)
    snapshot = await_snapshot(monitor, lambda s: [x.status for x in s.services] == ["ok", "ok", "missing"])
    assert not snapshot.ready
    arm.say_health("control", HEALTH_STATUS_DEGRADED, "sees nothing")
    snapshot = await_snapshot(monitor, lambda s: s.services[2].status == "degraded")
    assert snapshot.services[2].detail == "sees nothing"
    assert not snapshot.ready
    assert snapshot.works
    assert snapshot.troubles == ("control: sees nothing",)
    arm.say_health("control", HEALTH_STATUS_WAITING, "solver loading")
    await_snapshot(monitor, lambda s: not s.works)
    arm.say_health("control")
    snapshot = await_snapshot(monitor, lambda s: s.ready)
    assert snapshot.services[0].counters == {"refused_stale": 3}
    assert snapshot.services[0].gauges == {"rate_hz": 30.0}


def test_a_service_that_falls_silent_is_missing(
    monitor: Monitor, arm: FakeArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_STALE_S", 0.2)
    for name in ("sim", "vision", "control"):
        arm.say_health(name)
    await_snapshot(monitor, lambda s: s.ready)
    arm.say_status()
    await_snapshot(monitor, lambda s: s.mode == "track")
    snapshot = await_snapshot(monitor, lambda s: s.services[0].status == "missing")
    assert "silent" in snapshot.services[0].detail
    snapshot = await_snapshot(monitor, lambda s: s.mode == "")
    assert snapshot.tip is None


def test_status_gives_mode_pose_error_rate_and_latency(monitor: Monitor, arm: FakeArm) -> None:
    for latency_ms in [5.0] * 20 + [40.0]:
        time.sleep(0.01)  # only the newest is kept for who is slower
        arm.say_status(latency_ms)
    snapshot = await_snapshot(monitor, lambda s: s.latency_p99_ms == 40.0)
    assert (snapshot.mode, snapshot.state) == ("track", "moving")
    assert snapshot.error_m == pytest.approx(0.5)
    assert snapshot.joints == dict.fromkeys(("joint1", "joint2", "joint3", "joint4"), 0.1)
    assert snapshot.latency_p50_ms == 5.0
    assert 0 < snapshot.rate_hz <= 51 / 2
    line = live_line(snapshot)
    assert "track" in line
    assert "500 mm" in line
    assert "p99 40.0" in line


def test_who_stopped_the_arm_is_told(monitor: Monitor, arm: FakeArm, make_bus: Callable[[], Bus]) -> None:
    make_bus().query(topics.STOP, StopRequest(action=STOP_ACTION_STOP, source="door", reason="open"))
    snapshot = await_snapshot(monitor, lambda s: s.stopped_by == ("door",))
    assert arm.stopped_by == ["door"]
    assert "STOPPED by door" in live_line(snapshot)
