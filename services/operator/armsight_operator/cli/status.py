"""`armsight status`: how every service is, once or for as long as one looks."""

import dataclasses
import json
import time
from typing import TYPE_CHECKING, Annotated

import typer

from armsight.stopping import stop_on_signals
from armsight_operator.cli.options import Connect, Namespace, ZenohConfig

if TYPE_CHECKING:
    from armsight_operator.monitor import Snapshot

_GATHER_S = 2.2
"""Two periods of health."""


def status(
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object (a line a second with --follow).")] = False,
    follow: Annotated[bool, typer.Option("--follow", help="Go on until Ctrl-C or SIGTERM, a line a second.")] = False,
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Show health, rate, latency and mode of the running system. Exit code 1 where something is not well.

    Example: armsight status --json
    """
    from armsight_operator.cli.bus import configuration, connected, wait_connected
    from armsight_operator.monitor import Monitor

    config = configuration(connect, namespace, zenoh_config)
    if follow:
        stop = stop_on_signals()
        with wait_connected(config, stop) as bus:
            if bus is None:
                return
            monitor = Monitor(bus)
            while not stop.wait(1.0):
                snapshot = monitor.snapshot()
                print(_as_json(snapshot) if as_json else live_line(snapshot), flush=True)
        return
    with connected(config) as bus:
        monitor = Monitor(bus)
        until = time.monotonic() + _GATHER_S
        while time.monotonic() < until and not (monitor.snapshot().ready and monitor.snapshot().rate_hz > 0):
            time.sleep(0.1)
        time.sleep(1.0)  # for rate and latency to mean something
        snapshot = monitor.snapshot()
    if as_json:
        print(_as_json(snapshot))
    else:
        _print_table(snapshot)
    if not snapshot.ready:
        raise typer.Exit(1)


def live_line(snapshot: "Snapshot") -> str:
    """One line: mode, rate, latency, error, and what is wrong."""
    parts = [f"{snapshot.mode or 'no control'}  {snapshot.state}".rstrip(), f"{snapshot.rate_hz:4.1f} Hz"]
    if snapshot.latency_p50_ms is not None and snapshot.latency_p99_ms is not None:
        parts.append(f"frame to command {snapshot.latency_p50_ms:.1f} ms (p99 {snapshot.latency_p99_ms:.1f})")
    if snapshot.error_m is not None:
        parts.append(f"tip {snapshot.error_m * 1000:.0f} mm from target")
    if snapshot.stopped_by:
        parts.append(f"STOPPED by {', '.join(snapshot.stopped_by)}")
    parts += snapshot.troubles
    if snapshot.state != "moving" and snapshot.detail:
        parts.append(snapshot.detail)
    return " | ".join(parts)


def _as_json(snapshot: "Snapshot") -> str:
    return json.dumps({"ready": snapshot.ready, "error_m": snapshot.error_m} | dataclasses.asdict(snapshot))


def _print_table(snapshot: "Snapshot") -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("service", "status", "rate", "refused or malformed", "detail", box=None, pad_edge=False)
    for service in snapshot.services:
        rate = service.gauges.get("rate_hz")
        bad = sum(total for name, total in service.counters.items() if "refused" in name or "malformed" in name)
        shown_rate = "" if rate is None else f"{rate:.1f} Hz"
        table.add_row(service.name, service.status, shown_rate, str(bad) if bad else "", service.detail)
    console = Console(soft_wrap=True)
    console.print(table)
    console.print(live_line(snapshot), highlight=False)
    if snapshot.joints:
        angles = "  ".join(f"{name} {angle:+.3f}" for name, angle in snapshot.joints.items())
        console.print(f"estimated, rad: {angles}", highlight=False)
