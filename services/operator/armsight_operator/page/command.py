"""`armsight page`: serve the live web page."""

import argparse
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from armsight_operator.cli.options import Connect, Namespace, ZenohConfig

if TYPE_CHECKING:
    from armsight.service import Context

DEFAULT_PORT = 7448


def page(
    host: Annotated[str, typer.Option(help="Address to listen on: 127.0.0.1 is this machine alone.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="0: one that is free.", min=0, max=65535)] = DEFAULT_PORT,
    insecure_bind: Annotated[
        bool,
        typer.Option(
            "--insecure-bind", help="Listen where other machines connect: whoever opens the page moves the arm."
        ),
    ] = False,
    health: Annotated[bool, typer.Option("--health", help="Only ask whether it runs.")] = False,
    log_level: Annotated[
        Literal["debug", "info", "warning", "error"], typer.Option(help="What is logged, as JSON lines.")
    ] = "warning",
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Serve the live web page until SIGTERM or Ctrl-C: the arm in 3D, pictures, plots, and the stop button.

    Without viewers it listens to nothing but the arm's description. From another machine:
    ssh -L 7448:127.0.0.1:7448 HOST, then http://127.0.0.1:7448 there.

    Example: armsight page --port 8000
    """
    from armsight_operator.exposure import check_host_exposure

    if not insecure_bind:
        check_host_exposure(host, "a page", "whoever opens it moves the arm", "come by `ssh -L`")
    arguments = argparse.Namespace(
        connect=connect, namespace=namespace, zenoh_config=zenoh_config, health=health, log_level=log_level
    )
    if code := _run(arguments, host, port):
        raise typer.Exit(code)


def _run(arguments: argparse.Namespace, host: str, port: int) -> int:
    from armsight.service import run_service
    from armsight_operator.page.service import NAME, Settings

    def body(context: "Context") -> None:
        from armsight_operator.page.server import Server
        from armsight_operator.page.service import Page

        with Server(host, port) as server:
            page = Page(context.bus, server, "armsight")
            print(f"the page is at {server.address}", flush=True)
            try:
                page.run(context)
            finally:
                page.close()

    return run_service(NAME, arguments, Settings(host, port), body, role="operator")
