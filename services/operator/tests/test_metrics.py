"""What is heard becomes metrics: names, units, totals over restarts, and a bound on all of it."""

import json
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from prometheus_client.openmetrics.exposition import generate_latest
from prometheus_client.openmetrics.parser import text_string_to_metric_families

from armsight import topics
from armsight.bus import Bus, Received
from armsight.times import to_timestamp
from armsight.v1.control_pb2 import CONTROL_MODE_TRACK, ControlStatus
from armsight.v1.health_pb2 import HEALTH_STATUS_OK, Health
from armsight.v1.joints_pb2 import JointPositions, StageTimes
from armsight.v1.safety_pb2 import StopSource, StopState
from armsight.v1.sim_pb2 import Clock
from armsight_operator import monitor
from armsight_operator.errors import InsecureBindError, PortInUseError
from armsight_operator.metrics import MetricsServer, Watch, registry
from armsight_operator.metrics.counted import Meaning, meaning
from armsight_operator.metrics.routers import Router, ask_routers, router_of
from armsight_operator.metrics.server import check_host
from armsight_operator.metrics.totals import Totals
from armsight_operator.metrics.watch import MOST_NAMES, MOST_SERVICES
from secure_bus import SecureBus

Samples = dict[tuple[str, tuple[tuple[str, str], ...]], float]


def scraped(watch: Watch) -> Samples:
    """As Prometheus reads it."""
    return parsed(generate_latest(registry(watch.observe)).decode())  # type: ignore[no-untyped-call]


def parsed(text: str) -> Samples:
    families = list(text_string_to_metric_families(text))  # type: ignore[no-untyped-call]
    assert all(family.documentation for family in families if family.name.startswith("armsight"))
    return {
        (sample.name, tuple(sorted(sample.labels.items()))): sample.value
        for family in families
        for sample in family.samples
    }


def of(samples: Samples, name: str, **labels: str) -> float | None:
    return samples.get((f"armsight_{name}", tuple(sorted(labels.items()))))


def hear(watch: Watch, name: str, *, instance: str = "a", **fields: object) -> None:
    health = Health(service=name, status=HEALTH_STATUS_OK, instance=instance, **fields)  # type: ignore[arg-type]
    watch.take_health(Received(health, f"health/{name}", name, time.monotonic()))


def received(message: object) -> Received:  # type: ignore[type-arg]
    return Received(message, "", "", time.monotonic())


def test_every_service_of_the_loop_is_there_before_it_was_heard_of() -> None:
    samples = scraped(Watch())
    assert [of(samples, "service_up", service=name) for name in topics.SERVICES] == [0.0] * 3
    assert of(samples, "bus_connected") == 0.0


def test_a_service_that_falls_silent_is_down_and_its_totals_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = Watch()
    hear(watch, "sim", counters={"command_refused_stale": 3}, gauges={"rate_hz": 29.5, "render_ms": 12.0})
    samples = scraped(watch)
    assert of(samples, "service_up", service="sim") == 1.0
    assert of(samples, "service_status", service="sim", armsight_service_status="ok") == 1.0
    assert of(samples, "rate_hertz", service="sim") == 29.5
    assert of(samples, "render_seconds", service="sim") == pytest.approx(0.012)
    monkeypatch.setattr(monitor, "_STALE_S", -1.0)
    samples = scraped(watch)
    assert of(samples, "service_up", service="sim") == 0.0
    assert of(samples, "service_status", service="sim", armsight_service_status="missing") == 1.0
    assert of(samples, "rate_hertz", service="sim") is None
    assert of(samples, "refused_total", service="sim", what="command", reason="stale") == 3.0


def test_a_restarted_service_counts_on() -> None:
    watch = Watch()
    hear(watch, "sim", instance="a", counters={"command_refused_stale": 10})
    hear(watch, "sim", instance="b", counters={"command_refused_stale": 12})  # more than before: no reset to be seen
    hear(watch, "sim", instance="b", counters={"command_refused_stale": 13})
    samples = scraped(watch)
    assert of(samples, "refused_total", service="sim", what="command", reason="stale") == 23.0
    assert of(samples, "service_restarts_total", service="sim") == 1.0


def test_totals_never_fall_and_two_under_one_name_are_not_counted_anew_each_time() -> None:
    totals, seen = Totals(), []
    for _ in range(50):
        for instance, counted in (("a", 100.0), ("b", 7.0)):
            totals.take(instance, {"x": counted})
            seen.append(totals.totals["x"])
    assert seen == sorted(seen)
    assert totals.totals["x"] == 107.0
    totals.take("a", {"x": 3.0})  # started anew without saying so
    assert totals.totals["x"] == 110.0


@pytest.mark.parametrize(
    ("service", "counter", "means"),
    [
        ("sim", "command_refused_out_of_order", Meaning("refused", ("command", "out_of_order"))),
        ("sim", "refused_stop", Meaning("refused", ("stop", "request"))),
        ("control", "target_refused", Meaning("refused", ("target", "invalid"))),
        ("vision", "image_refused_step", Meaning("refused", ("image", "step"))),
        ("vision", "malformed_camera_image", Meaning("malformed", ("camera_image",))),
        ("control", "ik_unreachable", Meaning("ik", ("unreachable",))),
        ("control", "safety_slowed_for_limit", Meaning("safety", ("slowed_for_limit",))),
        ("control", "held_no_motion", Meaning("held", ("no_motion",))),
        ("vision", "instants_answered", Meaning("frames", ("measured",))),
        ("control", "side_switch", Meaning("events", ("side_switch",))),
        ("sim", "held_", Meaning("events", ("held_",))),
    ],
)
def test_names_of_counters_mean_what_they_say(service: str, counter: str, means: Meaning) -> None:
    assert meaning(service, counter) == means


def test_stages_are_counted_in_seconds_each_once() -> None:
    watch = Watch()
    begin = 1_800_000_000_000_000_000
    stages = StageTimes(
        frames_sent_ns=begin,
        vision_received_ns=begin + 1_500_000,
        vision_sent_ns=begin + 4_500_000,
        control_received_ns=begin + 5_000_000,
        control_sent_ns=begin + 25_000_000,
    )
    watch.take_positions(received(JointPositions(stages=stages)))
    watch.take_status(received(ControlStatus(stages=stages, mode=CONTROL_MODE_TRACK)))
    samples = scraped(watch)
    sums = {
        stage: of(samples, "stage_latency_seconds_sum", stage=stage)
        for stage in ("frames", "vision", "positions", "control", "frame_to_command")
    }
    assert sums == pytest.approx(
        {"frames": 0.0015, "vision": 0.003, "positions": 0.0005, "control": 0.02, "frame_to_command": 0.025}
    )
    assert of(samples, "stage_latency_seconds_bucket", stage="vision", le="0.002") == 0.0
    assert of(samples, "stage_latency_seconds_bucket", stage="vision", le="0.003") == 1.0
    assert of(samples, "stage_latency_seconds_bucket", stage="vision", le="+Inf") == 1.0
    assert of(samples, "control_mode", armsight_control_mode="track") == 1.0


def test_stages_that_clocks_contradict_are_left_out_and_counted() -> None:
    watch = Watch()
    watch.take_positions(received(JointPositions(stages=StageTimes(frames_sent_ns=10, vision_received_ns=5))))
    samples = scraped(watch)
    assert of(samples, "stage_latency_seconds_count", stage="frames") == 0.0
    assert of(samples, "metrics_ignored_total", what="stage_time") == 1.0


def test_frames_are_counted_over_a_restart_of_sim() -> None:
    watch = Watch()
    for frame in (0, 1, 2, 0, 1):
        watch.take_clock(received(Clock(frame=frame)))
    assert of(scraped(watch), "frames_total", service="sim", step="drawn") == 3.0


def test_who_stops_the_arm_is_counted_and_not_named() -> None:
    watch = Watch()
    assert of(scraped(watch), "stop_sources") is None
    state = StopState(sources=[StopSource(name="x" * 10_000, stopped=True), StopSource(name="y")])
    watch.take_stop(received(state))
    samples = scraped(watch)
    assert of(samples, "stop_sources") == 1.0
    assert not any("xxx" in str(key) for key in samples)


def test_a_flood_of_names_is_bounded_and_counted() -> None:
    watch = Watch()
    for number in range(500):
        hear(watch, f"intruder{number}", counters={"x": 1})
    for number in range(20):
        names = {f"name_{number}_{i}": 1 for i in range(100)}
        hear(watch, "sim", instance=str(number), counters=names, gauges={"g" * 1000: 1.0, "ä\n{}": 2.0})
    samples = scraped(watch)
    services = {dict(labels)["service"] for (name, labels) in samples if name == "armsight_service_up"}
    assert len(services) == MOST_SERVICES
    assert set(topics.SERVICES) <= services
    of_sim = [labels for name, labels in samples if name == "armsight_events_total" and ("service", "sim") in labels]
    assert len(of_sim) == MOST_NAMES
    assert of(samples, "metrics_ignored_total", what="service_name") == 500 - (MOST_SERVICES - 3)
    assert of(samples, "metrics_ignored_total", what="counter_name") == 2000 - MOST_NAMES
    assert of(samples, "metrics_ignored_total", what="gauge_name") == 40


def test_values_that_are_none_and_statuses_of_the_future_break_nothing() -> None:
    watch = Watch()
    message = Health(
        service="sim",
        status=99,  # type: ignore[arg-type]
        counters={"command_move": 2**64 - 1},
        gauges={"rate_hz": float("nan"), "speed": float("inf"), "watchdog_trips": -1.0, "render_ms": 4.0},
        version="v" * 1000,
        detail="d" * 100_000,
    )
    watch.take_health(Received(message, "health/sim", "sim", time.monotonic()))
    watch.take_status(received(ControlStatus(mode=77)))  # type: ignore[arg-type]
    samples = scraped(watch)
    assert of(samples, "service_status", service="sim", armsight_service_status="unknown") == 1.0
    assert of(samples, "control_mode", armsight_control_mode="unknown") == 1.0
    assert of(samples, "rate_hertz", service="sim") is None
    assert of(samples, "render_seconds", service="sim") == pytest.approx(0.004)
    assert of(samples, "metrics_ignored_total", what="gauge_value") == 2.0


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost"])
def test_the_loopback_is_served_without_asking(host: str) -> None:
    check_host(host, insecure_bind=False)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.1", "robot.local", ""])  # noqa: S104
def test_other_machines_read_only_where_that_is_wanted(host: str) -> None:
    with pytest.raises(InsecureBindError, match="--insecure-bind"):
        check_host(host, insecure_bind=False)
    check_host(host, insecure_bind=True)


def get(url: str, accept: str = "application/openmetrics-text; version=1.0.0") -> tuple[int, str, str]:
    request = urllib.request.Request(url, headers={"Accept": accept})  # noqa: S310
    try:
        with urllib.request.urlopen(request, timeout=5) as answer:  # noqa: S310
            return answer.status, answer.headers["Content-Type"], answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.headers["Content-Type"], error.read().decode()


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_it_answers_over_http_in_openmetrics_and_says_how_it_is(host: str) -> None:
    watch, well = Watch(), [False]
    with MetricsServer(host, 0, registry(watch.observe), lambda: well[0]) as server:
        code, kind, text = get(server.url)
        assert (code, kind.split(";")[0]) == (200, "application/openmetrics-text")
        assert text.endswith("# EOF\n")
        assert of(parsed(text), "service_up", service="vision") == 0.0
        assert "armsight_metrics_process_cpu_seconds_total" in text
        base = server.url.removesuffix("/metrics")
        assert get(f"{base}/healthz")[0] == 503
        well[0] = True
        assert get(f"{base}/healthz")[0] == 200
        assert get(f"{base}/nowhere")[0] == 404
        port = int(base.rpartition(":")[2])
        with pytest.raises(PortInUseError, match="--port"):
            MetricsServer(host, port, registry(watch.observe), lambda: True)


@contextmanager
def serving(endpoint: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`armsight metrics` as a process, and where it serves."""
    command = [sys.executable, "-c", "from armsight_operator.cli.app import main; main()", "metrics", "--port", "0"]
    process = subprocess.Popen([*command, "--connect", endpoint], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process, process.stdout.readline().split()[-1]
    finally:
        process.kill()
        process.wait()


def test_the_command_serves_what_it_hears_and_ends_on_sigterm(endpoint: str, make_bus: Callable[[], Bus]) -> None:
    bus = make_bus()
    health, clock = bus.publisher(topics.HEALTH, "sim"), bus.publisher(topics.CLOCK)
    with serving(endpoint) as (process, url):
        until = time.monotonic() + 20
        samples: Samples = {}
        while of(samples, "refused_total", service="sim", what="command", reason="stale") != 4.0:
            assert time.monotonic() < until, samples
            health.put(Health(service="sim", instance="a", counters={"command_refused_stale": 4}))
            clock.put(Clock(capture_time=to_timestamp(1), frame=8))
            time.sleep(0.05)
            samples = parsed(get(url)[2])
        assert of(samples, "bus_connected") == 1.0
        assert of(samples, "service_up", service="sim") == 1.0
        (router,) = {dict(labels)["router"] for name, labels in samples if name == "armsight_router_info"}
        # this test's place on the bus, the exporter's, and its one outside of the robot's namespace
        assert of(samples, "router_sessions", router=router, kind="client") == 3.0
        assert of(samples, "router_sessions", router=router, kind="router") == 0.0
        assert of(samples, "router_links", router=router, protocol="tcp") == 3.0
        began = time.monotonic()
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=5) == 0
        assert time.monotonic() - began < 2.0


def test_it_serves_and_ends_where_there_is_no_router() -> None:
    with serving("tcp/127.0.0.1:1") as (process, url):
        assert of(parsed(get(url)[2]), "bus_connected") == 0.0
        assert get(url.replace("/metrics", "/healthz"))[0] == 503
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=2) == 0


def test_with_certificates_whoever_may_look_may_serve_metrics(tmp_path: Path) -> None:
    secure = SecureBus(tmp_path)
    secure.start_router()
    try:
        watch = Watch()
        watch.listen(secure.bus("viewer"), secure.outside("viewer"))
        publisher = secure.bus("sim").publisher(topics.HEALTH, "sim")
        until = time.monotonic() + 10
        while of(scraped(watch), "service_up", service="sim") != 1.0:
            assert time.monotonic() < until
            publisher.put(Health(service="sim", status=HEALTH_STATUS_OK, instance="a"))
            time.sleep(0.05)
        assert of(scraped(watch), "bus_connected") == 1.0
        (router,) = ask_routers(secure.outside("operator"))
        assert router.sessions["client"] == router.links["tls"] == 4
        assert ask_routers(secure.outside("vision")) == (), "it has no right to know who is there"
    finally:
        secure.close()


def test_a_router_is_counted_by_what_it_says_and_not_by_what_it_might() -> None:
    told = {
        "zid": "ab" * 100,
        "version": "v1.10.2-cc83 built with rustc",
        "sessions": [
            {"whatami": "client", "links": [{"src": "tls/a:1"}, {"src": "tcp/a:1"}]},
            {"whatami": "router", "links": [{"src": "carrier-pigeon/a:1"}, 7, {"src": 7}]},
            {"whatami": ["x"], "links": None},
            "nonsense",
        ],
    }
    router = router_of(json.dumps(told).encode())
    assert router == Router(
        name="ab" * 32,
        version="v1.10.2",
        sessions={"client": 1, "peer": 0, "router": 1, "other": 1},
        links={"tcp": 1, "tls": 1, "other": 3},
    )


@pytest.mark.parametrize(
    "payload", [b"", b"\xff", b"7", b"[]", b"{}", b'{"zid":"a","version":"1","sessions":7}', b"[" * 100_000]
)
def test_what_is_no_routers_account_is_none(payload: bytes) -> None:
    assert router_of(payload) is None
