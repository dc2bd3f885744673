"""The whole command line as one page: made from what --help says, so that it can't say anything else."""

from collections.abc import Iterator
from typing import Any

from typer.main import get_command

_WIDTH = 110


def every_command() -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command that does something, with the words that call it, in the order of the help."""
    from armsight_operator.cli.app import app

    yield from _under((), get_command(app))


def reference() -> str:
    """Markdown: a heading and the help of each command."""
    return "\n".join(_section(path, command) for path, command in every_command())


def help_of(path: tuple[str, ...], command: Any) -> str:
    """What --help prints, at a width of its own."""
    name = " ".join(("armsight", *path))
    return str(command.get_help(_context(command, name, terminal_width=_WIDTH)))


def _under(path: tuple[str, ...], command: Any) -> Iterator[tuple[tuple[str, ...], Any]]:
    if not hasattr(command, "list_commands"):
        yield path, command
        return
    context = _context(command, " ".join(path) or "armsight")
    for name in command.list_commands(context):
        # resolved as for running: what is imported late comes with its options
        _, found, _ = command.resolve_command(context, [name])
        yield from _under((*path, name), found)


def _context(command: Any, name: str, **settings: Any) -> Any:
    from armsight_operator.cli.app import app

    inherited = app.info.context_settings or {}  # as from `armsight` itself, when it runs
    return command.context_class(command, info_name=name, **inherited | command.context_settings | settings)


def _section(path: tuple[str, ...], command: Any) -> str:
    lines = [line.rstrip() for line in help_of(path, command).strip().splitlines()]
    return "\n".join((f"### armsight {' '.join(path)}", "", "```", *lines, "```", ""))
