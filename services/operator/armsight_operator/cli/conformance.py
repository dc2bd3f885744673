"""`armsight conformance`: whether a service of one's own fulfils the contract."""

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from armsight_operator.cli.options import Connect, Namespace, ZenohConfig

if TYPE_CHECKING:
    from armsight_operator.conformance import Result, Suite

_STYLES = {"passed": "green", "failed": "bold red", "not applicable": "blue"}


class Service(StrEnum):
    """Which part of the loop it is."""

    VISION = "vision"
    CONTROL = "control"
    SIM = "sim"


def conformance(
    service: Annotated[Service, typer.Argument(help="What it is in the loop.", show_default=False)],
    only: Annotated[
        list[str] | None,
        typer.Option("--only", metavar="NAME", help="This check alone; may be given again.", show_default=False),
    ] = None,
    as_list: Annotated[bool, typer.Option("--list", help="List the checks, and ask nobody.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Check a service of your own against the contract, and say what it does not fulfil.

    The suite plays the other parts of the loop itself: of these none may be there. It changes modes, and moves the arm
    of a sim. Exit code 1 where something is not fulfilled, 2 where the command can't be used.

    Example: armsight conformance control --connect tcp/127.0.0.1:7447

    Example: armsight conformance vision --only malformed --json
    """
    from armsight_operator.cli.bus import configuration, connected
    from armsight_operator.conformance import Outcome, run, suite_of

    suite = suite_of(service.value)
    checks = suite.chosen(only or ())
    if as_list:
        _list(suite, only or [], as_json)
        return
    results = []
    with (
        connected(configuration(connect, namespace, zenoh_config)) as bus,
        _progress() as begin,
    ):
        for result in run(bus, suite, only or (), begin):
            results.append(result)
            if not as_json:
                _print(result)
    counts = {outcome: sum(result.outcome is outcome for result in results) for outcome in Outcome}
    failed = counts[Outcome.FAILED]
    if as_json:
        print(
            json.dumps({"service": service.value, "ok": not failed, "checks": [result.as_dict() for result in results]})
        )
    else:
        told = ", ".join(f"{count} {outcome.value}" for outcome, count in counts.items() if count)
        print(f"{service.value}: {told}, of {len(checks)} checks")
    if failed:
        raise typer.Exit(1)


def _list(suite: "Suite", only: list[str], as_json: bool) -> None:
    for check in suite.chosen(only):
        if as_json:
            print(json.dumps({"check": check.name, "contract": check.says, "where": check.stands}))
        else:
            print(f"{check.name:20} {check.says} ({check.stands})")


def _print(result: "Result") -> None:
    from rich.console import Console
    from rich.text import Text

    console = Console(soft_wrap=True, highlight=False, no_color=not sys.stdout.isatty())
    outcome = result.outcome.value
    line = Text.assemble((f"{outcome:14}", _STYLES[outcome]), f" {result.name}")
    if result.seen:
        line += Text(f": {result.seen}")
    if result.expected:
        line += Text(f"; expected {result.expected}. {result.says} ({result.stands})")
    console.print(line)


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """Shows which check is being made, where somebody looks."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console

    with Console(stderr=True).status("") as status:
        yield lambda name: status.update(name)
