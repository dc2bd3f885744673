"""`armsight metrics`: what the services say of themselves, for Prometheus."""

from dataclasses import replace
from typing import Annotated

import typer

from armsight.stopping import stop_on_signals
from armsight_operator.cli.options import Connect, Namespace, ZenohConfig

PORT = 9464


def metrics(
    port: Annotated[int, typer.Option(help="Port to serve at; 0: a free one.", min=0, max=65535)] = PORT,
    host: Annotated[str, typer.Option(help="Address to serve at: IPv4 or IPv6.")] = "127.0.0.1",
    insecure_bind: Annotated[
        bool, typer.Option("--insecure-bind", help="Serve where other machines read it, though to everybody.")
    ] = False,
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Serve health, rates, latency, refusals and solver times as OpenMetrics, until SIGTERM or Ctrl-C.

    Serves before there is a router, too, and says so: armsight_bus_connected. /healthz answers 503 meanwhile.

    Example: armsight metrics --port 9464
    """
    from armsight.logs import set_up_logging
    from armsight_operator.cli.bus import configuration, wait_connected
    from armsight_operator.exposure import check_host_exposure
    from armsight_operator.metrics import MetricsServer, Watch, registry

    config = configuration(connect, namespace, zenoh_config)
    if not insecure_bind:
        check_host_exposure(host, "metrics", "whoever asks reads them")
    set_up_logging("metrics", "warning")
    stop = stop_on_signals()
    watch = Watch()
    with MetricsServer(host, port, registry(watch.observe), watch.connected) as server:
        print(f"metrics at {server.url}", flush=True)
        with wait_connected(config, stop) as bus:
            if bus is None:
                return
            # what routers tell of themselves is in no robot's namespace
            with wait_connected(replace(config, namespace=""), stop) as outside:
                watch.listen(bus, None if outside is None else outside.session)
                stop.wait()
                watch.leave()
