"""The command line: which commands there are, and how their errors end."""

import importlib
import os
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException
from typer.main import get_command

from armsight_operator.cli import (
    bridge,
    calibrate,
    camera,
    certs,
    conformance,
    describe,
    doctor,
    export,
    metrics,
    motion,
    params,
    record,
    recording,
    replay,
    router,
    snapshot,
    status,
    stop,
    topics,
    trace,
    up,
)

REFUSED = 1
"""Exit code: a service refused, or nobody answered."""

USAGE = 2
"""Exit code: the command line, the environment or a file can't be used."""

INTERRUPTED = 130
"""Exit code: Ctrl-C, as shells have it."""

# Numbers such as -0.4 are arguments, not options.
NEGATIVE_NUMBERS = {"ignore_unknown_options": True}

_LATER = {
    "page": (
        "armsight_operator.page.command",
        "Serve the live web page: the arm in 3D, pictures, plots, a stop button.",
    ),
    "report": ("armsight_operator.report.command", "Measure the whole pipeline against the truth: tables, plots."),
}
"""Commands whose module is only imported when they run: its function has the command's name."""


class Commands(TyperGroup):
    """The commands, with those that are imported late."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names in the order of the help."""
        return [*super().list_commands(ctx), *_LATER]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """For the help: a late command without its options."""
        if cmd_name in _LATER:
            return TyperCommand(cmd_name, help=_LATER[cmd_name][1])
        return super().get_command(ctx, cmd_name)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """For running: a late command with everything."""
        if not args or args[0] not in _LATER:
            return super().resolve_command(ctx, args)
        name = args[0]
        alone = typer.Typer(add_completion=False, rich_markup_mode=None)
        alone.command(name)(getattr(importlib.import_module(_LATER[name][0]), name))
        return name, get_command(alone), args[1:]


app = typer.Typer(
    name="armsight",
    cls=Commands,
    help="Watch a robot arm through two cameras, and move it.",
    no_args_is_help=True,
    # Plain text: quick to show, and the same in a pipe.
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def armsight() -> None:
    """Makes `armsight` a group however many commands it has."""


app.command("up")(up.up)
app.command("status")(status.status)
app.command("move", context_settings=NEGATIVE_NUMBERS)(motion.move)
app.command("target", context_settings=NEGATIVE_NUMBERS)(motion.target)
app.command("mode")(motion.mode)
app.command("stop")(stop.stop)
app.command("release")(stop.release)
app.command("reset", context_settings=NEGATIVE_NUMBERS)(motion.reset)
app.add_typer(topics.app, name="topics")
app.add_typer(params.app, name="params")
app.command("metrics")(metrics.metrics)
app.command("doctor")(doctor.doctor)
app.command("conformance")(conformance.conformance)
app.command("describe")(describe.describe)
app.command("trace")(trace.trace)
app.command("snapshot")(snapshot.snapshot)
app.command("camera", context_settings=camera.PASSED_ON)(camera.camera)
app.command("record")(record.record)
app.add_typer(recording.app, name="recording")
app.command("replay")(replay.replay)
app.command("export")(export.export)
app.add_typer(calibrate.app, name="calibrate")
app.add_typer(bridge.app, name="bridge")
app.command("router")(router.router)
app.add_typer(certs.app, name="certs")


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command line; errors that are meant for people end it with one line."""
    from armsight.errors import ArmsightError, ConfigError

    try:
        sys.exit(app(arguments, prog_name="armsight", standalone_mode=False))
    except TyperException as error:  # the command line itself
        context = getattr(error, "ctx", None)
        where = context.command_path if context is not None else "armsight"
        _fail(f"{error.format_message().rstrip('.')}; see `{where} --help`", error.exit_code)
    except (typer.Abort, KeyboardInterrupt):
        sys.exit(INTERRUPTED)
    except ArmsightError as error:
        _fail(str(error), USAGE if isinstance(error, ConfigError) else REFUSED)
    except BrokenPipeError:  # `armsight topics echo … | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)


def _fail(text: str, code: int) -> NoReturn:
    print(f"armsight: {text}", file=sys.stderr)
    sys.exit(code)
