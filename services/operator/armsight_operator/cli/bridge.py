"""`armsight bridge foxglove`: the running system in Foxglove and Lichtblick."""

from typing import Annotated

import typer

from armsight.stopping import stop_on_signals
from armsight_operator.cli.options import Connect, Namespace, ZenohConfig

app = typer.Typer(
    help="Look at the running system with other applications.", no_args_is_help=True, rich_markup_mode=None
)

_NEEDS = "armsight bridge foxglove needs the package foxglove-sdk: `pip install 'armsight-operator[bridge]'`"


@app.callback()
def bridge() -> None:
    """Makes `bridge` a group, however many there are."""


@app.command()
def foxglove(
    host: Annotated[str, typer.Option(help="Address to listen at.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="0: a free one.", min=0, max=65535)] = 8765,
    read_only: Annotated[bool, typer.Option("--read-only", help="Viewers can't publish a target.")] = False,
    insecure_bind: Annotated[
        bool,
        typer.Option(
            "--insecure-bind", help="Listen where other machines connect: whoever does sees, and sets targets."
        ),
    ] = False,
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Serve the bus live to Foxglove and Lichtblick (Open connection, Foxglove WebSocket), until Ctrl-C.

    A key is only listened to while somebody looks at it. Viewers can publish `target`, which control follows in mode
    track, and set parameters.

    Example: armsight bridge foxglove --port 8765
    """
    from armsight.errors import ConfigError
    from armsight.logs import set_up_logging
    from armsight_operator.cli.bus import configuration, wait_connected
    from armsight_operator.exposure import check_host_exposure

    if not insecure_bind:
        check_host_exposure(host, "the bridge", "whoever connects sees, and sets targets")
    try:
        from armsight_operator.bridge.foxglove_server import Bridge
    except ModuleNotFoundError as error:
        raise ConfigError(_NEEDS) from error
    set_up_logging("bridge", "warning")
    stop = stop_on_signals()
    with wait_connected(configuration(connect, namespace, zenoh_config, shared_memory="read"), stop) as bus:
        if bus is None:
            return
        bridge = Bridge(bus, host, port, writable=not read_only)
        try:
            address = f"[{host}]" if ":" in host else host
            print(f"Foxglove and Lichtblick connect to ws://{address}:{bridge.port}", flush=True)
            stop.wait()
        finally:
            bridge.close()
