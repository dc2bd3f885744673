"""`armsight stop` and `armsight release`."""

import getpass
from typing import Annotated

import typer

from armsight_operator.cli.options import Connect, Namespace, ZenohConfig

Source = Annotated[
    str | None, typer.Option("--source", help="Who stops; released by the same name. [default: cli-USER]")
]


def stop(
    reason: Annotated[str, typer.Option(help="Shown to everybody while the arm is stopped.")] = "stopped by hand",
    source: Source = None,
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Stop the arm: it decelerates and holds until `armsight release`.

    Example: armsight stop --reason "somebody is in the way"
    """
    from armsight_operator.ask import ask_stop
    from armsight_operator.cli.bus import configuration, connected

    name = source or _default_source()
    with connected(configuration(connect, namespace, zenoh_config)) as bus:
        ask_stop(bus, name, reason)
    print(f"stopped by {name}: `armsight release` lets it move again")


def release(
    source: Source = None,
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Take a stop back. Other sources that stopped the arm keep it stopped.

    Example: armsight release --source door
    """
    from armsight_operator.ask import ask_release, stopped_by
    from armsight_operator.cli.bus import configuration, connected

    name = source or _default_source()
    with connected(configuration(connect, namespace, zenoh_config)) as bus:
        others = stopped_by(ask_release(bus, name))
    print(f"still stopped by {', '.join(others)}: release each with --source" if others else "released")


def _default_source() -> str:
    try:
        return f"cli-{getpass.getuser()}"
    except (KeyError, OSError):  # a user id without a name, as in containers
        return "cli"
