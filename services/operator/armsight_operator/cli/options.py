"""Options that many commands have, spelt the same everywhere."""

from pathlib import Path
from typing import Annotated

import typer

Connect = Annotated[
    list[str] | None,
    typer.Option(
        "--connect",
        metavar="ENDPOINT",
        help="Router to connect to, may be given again. [environment: ARMSIGHT_CONNECT; default: tcp/127.0.0.1:7447]",
        show_default=False,
    ),
]
Namespace = Annotated[
    str | None,
    typer.Option(
        "--namespace",
        metavar="NAME",
        help="The robot's name. [environment: ARMSIGHT_NAMESPACE; default: robots/arm]",
        show_default=False,
    ),
]
ZenohConfig = Annotated[
    Path | None,
    typer.Option(
        "--zenoh-config",
        metavar="FILE",
        help="Zenoh JSON5 file, for TLS and access control. [environment: ARMSIGHT_ZENOH_CONFIG]",
        show_default=False,
    ),
]
