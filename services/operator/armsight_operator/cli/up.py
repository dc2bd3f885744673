"""`armsight up`: the full stack on this machine until Ctrl-C."""

import os
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armsight.stopping import stop_on_signals
from armsight_operator.errors import OperatorError

if TYPE_CHECKING:
    from armsight.bus import Bus
    from armsight_operator.monitor import Monitor, Snapshot
    from armsight_operator.stack import Stack, Supervisor

_PICTURE_EVERY_S = 10.0
_LINE_EVERY_S = 5.0
"""Without a terminal; in one the line is kept up to date."""
_POLL_S = 0.2


def up(
    port: Annotated[int, typer.Option(help="Of the router, on this machine only.", min=1, max=65535)] = 7447,
    mode: Annotated[str, typer.Option(help="Control's first mode.")] = "track",
    target: Annotated[str, typer.Option(help="Moving target: default, exercise, visible or none.")] = "default",
    model: Annotated[
        Path | None,
        typer.Option(help="MJCF or URDF of another arm (see `armsight describe`).", metavar="FILE", show_default=False),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="File of `armsight calibrate`: its cameras and colours in place of the model's.",
            metavar="FILE",
            show_default=False,
        ),
    ] = None,
    clock: Annotated[str, typer.Option(help="realtime or lockstep.")] = "realtime",
    samples: Annotated[int, typer.Option(help="Samples a pixel: 0 or 4 (smoother, slower).")] = 0,
    out: Annotated[Path, typer.Option(help="Folder for the picture and the logs.")] = Path("armsight-out"),
    namespace: Annotated[str, typer.Option(help="The robot's name.")] = "robots/arm",
    certificates: Annotated[
        Path | None,
        typer.Option(
            "--certificates",
            help="Folder of `armsight certs make`: mutual TLS, and for each service only the rights that it needs.",
            show_default=False,
        ),
    ] = None,
    page: Annotated[bool, typer.Option(help="Serve the live web page.")] = True,
    page_port: Annotated[
        int | None,
        typer.Option(
            help="Of the page, on this machine only. [default: the router's and 1]",
            min=1,
            max=65535,
            show_default=False,
        ),
    ] = None,
    restart: Annotated[bool, typer.Option(help="Start a service again that died.")] = True,
) -> None:
    """Run the full stack on this machine: router, sim, vision, control and a live web page. Ctrl-C stops all of it.

    Example: armsight up --target visible --mode follow
    """
    from armsight_operator.stack import Stack, Supervisor

    stop = stop_on_signals()
    began = time.monotonic()
    extra: dict[str, object] = {"target": target, "clock": clock, "samples": samples, "mode": mode}
    extra["model"], extra["calibration"] = model, calibration
    beside = port + 1 if port < 65535 else port - 1
    extra["page_port"] = (page_port or beside) if page else None
    with Stack(out=out, port=port, namespace=namespace, certificates=certificates, **extra) as stack:  # type: ignore[arg-type]
        stack.start_all()
        print(
            f"armsight starts on {stack.endpoint} (this machine only); logs in {stack.log_folder}; Ctrl-C stops it",
            flush=True,
        )
        _watch(stack, Supervisor(stack, restart=restart), stop, began, out / "view.png")


def _watch(stack: "Stack", supervisor: "Supervisor", stop: threading.Event, began: float, picture: Path) -> None:
    from armsight.session import SessionConfig
    from armsight_operator.cli.bus import wait_connected
    from armsight_operator.monitor import Monitor
    from armsight_operator.stack import PAGE

    config = SessionConfig(
        endpoints=(stack.endpoint,),
        namespace=stack.namespace,
        shared_memory="off",
        file=stack.zenoh_config("operator"),
    )
    with wait_connected(config, stop) as bus:
        if bus is None:
            return
        monitor = Monitor(bus)
        painter = threading.Thread(target=_paint, args=(bus, monitor, picture, stop), name="picture", daemon=True)
        line = _LiveLine()
        ready_s: float | None = None
        while not stop.wait(_POLL_S):
            for death in supervisor.poll():
                line.print(f"armsight: {death}")
                if death.hopeless and death.name != PAGE:  # the arm does without
                    raise OperatorError(f"{death.name} can't use its configuration: {death.last_line}")
            snapshot = monitor.snapshot()
            if ready_s is None and snapshot.works:
                ready_s = time.monotonic() - began
                but = "".join(f", but {trouble}" for trouble in snapshot.troubles)
                line.print(f"ready after {ready_s:.1f} s{but}; {_where_to_look(stack, picture)}")
                painter.start()
            line.update(snapshot)
        line.end()
        if ready_s is not None:
            painter.join(timeout=1.0)
    print("armsight stopped", flush=True)


def _where_to_look(stack: "Stack", picture: Path) -> str:
    seen = f"what the cameras see: {picture}"
    return seen if stack.page_port is None else f"look and steer at http://127.0.0.1:{stack.page_port}; {seen}"


def _paint(bus: "Bus", monitor: "Monitor", picture: Path, stop: threading.Event) -> None:
    from armsight.errors import ArmsightError
    from armsight_operator.cli.status import live_line
    from armsight_operator.picture import draw, take_views

    while not stop.is_set():
        try:
            image = draw(take_views(bus), live_line(monitor.snapshot()))
            partial = picture.with_suffix(".part.png")
            image.save(partial)
            partial.replace(picture)  # whoever looks sees the old or the new one, never half of it
        except (ArmsightError, ValueError, OSError) as error:
            if not stop.is_set():
                print(f"\narmsight: no picture: {error}", file=sys.stderr, flush=True)
        stop.wait(_PICTURE_EVERY_S)


class _LiveLine:
    """One line that is kept up to date in a terminal, and repeated now and then elsewhere."""

    def __init__(self) -> None:
        self._in_terminal = sys.stdout.isatty()
        self._printed_s = 0.0

    def update(self, snapshot: "Snapshot") -> None:
        from armsight_operator.cli.status import live_line

        text = live_line(snapshot)
        if self._in_terminal:
            width = os.get_terminal_size(sys.stdout.fileno()).columns or 120
            print(f"\r\x1b[K{text[: width - 1]}", end="", flush=True)
        elif time.monotonic() - self._printed_s >= _LINE_EVERY_S:
            self._printed_s = time.monotonic()
            print(text, flush=True)

    def print(self, text: str) -> None:
        print(f"\r\x1b[K{text}" if self._in_terminal else text, flush=True)

    def end(self) -> None:
        if self._in_terminal:
            print(flush=True)
