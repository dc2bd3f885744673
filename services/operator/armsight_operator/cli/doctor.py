"""`armsight doctor`: whether this machine can run armsight, and how to mend what is wrong."""

import json
import sys
from typing import TYPE_CHECKING, Annotated

import typer

from armsight_operator.cli import metrics
from armsight_operator.cli.options import Connect, Namespace, ZenohConfig
from armsight_operator.page.command import DEFAULT_PORT

if TYPE_CHECKING:
    from armsight_operator.doctor import Finding

PORTS = {DEFAULT_PORT: "armsight page", metrics.PORT: "armsight metrics"}
"""Where commands serve unless they are told otherwise."""

_STYLES = {"ok": "green", "info": "blue", "warning": "yellow", "broken": "bold red"}


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Check what armsight needs of this machine, and say how to mend what is missing.

    Graphics, ports, memory, clock, versions, disk, compiled solvers, the bus and who is on it, Docker. Exit code 1
    where something is broken; warnings alone are no failure.

    Example: armsight doctor --json
    """
    from armsight_operator.cli.bus import configuration
    from armsight_operator.doctor import Level, examine

    findings = examine(configuration(connect, namespace, zenoh_config), PORTS)
    well = all(finding.level is not Level.BROKEN for finding in findings)
    if as_json:
        print(json.dumps({"ok": well, "checks": [_as_dict(finding) for finding in findings]}))
    else:
        _print(findings)
    if not well:
        raise typer.Exit(1)


def _as_dict(finding: "Finding") -> dict[str, str]:
    return {"check": finding.check, "level": finding.level.value, "found": finding.found, "mend": finding.mend}


def _print(findings: "list[Finding]") -> None:
    from rich.console import Console
    from rich.text import Text

    console = Console(soft_wrap=True, highlight=False, no_color=not sys.stdout.isatty())
    for finding in findings:
        level = finding.level.value
        line = Text.assemble((f"{level:8}", _STYLES[level]), f" {finding.check}: {finding.found}")
        console.print(line + Text(f"; {finding.mend}") if finding.mend else line)
