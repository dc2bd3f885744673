"""`armsight replay`: a recording back onto the bus."""

from pathlib import Path
from typing import Annotated

import typer

from armsight.stopping import stop_on_signals
from armsight_operator.cli.options import Connect, Namespace, ZenohConfig


def replay(
    files: Annotated[list[Path], typer.Argument(help="MCAP files of one recording.")],
    to: Annotated[
        str, typer.Option("--for", help="Whose inputs to put: vision, control, or operator (everything to look at).")
    ] = "vision",
    key: Annotated[
        list[str] | None,
        typer.Option("--key", metavar="KEY", help="Only such keys of them; may be given again.", show_default=False),
    ] = None,
    without: Annotated[
        list[str] | None,
        typer.Option("--without", metavar="KEY", help="Leave a key out; may be given again.", show_default=False),
    ] = None,
    lockstep: Annotated[
        bool, typer.Option("--lockstep", help="Wait for the answer to each instant, and send nothing before.")
    ] = False,
    rate: Annotated[float, typer.Option(help="Recorded seconds a second.", min=0.01, max=100)] = 1.0,
    start: Annotated[float, typer.Option(help="Where to begin, s.", min=0)] = 0.0,
    end: Annotated[float | None, typer.Option(help="Where to end, s.", min=0, show_default=False)] = None,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end, until Ctrl-C.")] = False,
    with_commands: Annotated[
        bool,
        typer.Option(
            "--with-commands",
            help="Put joints/command, joints/accepted, safety/stop and health as well: never where there is an arm.",
        ),
    ] = False,
    beside_sim: Annotated[
        bool, typer.Option("--beside-sim", help="Replay though sim is on the bus, and its arm may move.")
    ] = False,
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Put a recording on the bus again, in the place of sim: for vision or control.

    Example: armsight replay run.mcap

    Example: armsight replay run.mcap --lockstep

    Example: armsight replay run.mcap --rate 0.2 --start 10 --end 12 --loop

    Example: armsight replay run.mcap --for control --with-commands
    """
    from armsight_operator.cli.bus import configuration, connected
    from armsight_operator.recording.reader import Recording
    from armsight_operator.recording.replay import Replay, Span, check_no_sim, inputs_of
    from armsight_operator.recording.selection import select

    recording = Recording(*files)
    inputs = inputs_of(to, guarded=with_commands)
    selection = select(key or (), without or ())
    stop = stop_on_signals()
    with connected(configuration(connect, namespace, zenoh_config)) as bus:
        if not beside_sim:
            check_no_sim(bus)
        player = Replay(
            bus,
            recording,
            lambda topic, name: topic in inputs and selection.has(name),
            lockstep=lockstep,
            as_sim=not beside_sim,
        )
        print(f"replays {', '.join(sorted(player.keys))}", flush=True)
        played = player.run(stop, Span(start, end), rate, loop=loop)
    answered = f", {played.answered} instants answered" if lockstep else f", at most {1000 * played.late_s:.0f} ms late"
    print(f"replayed {played.messages} messages{answered}")
    for path, trouble in recording.troubles.items():
        print(f"{path}: {trouble}")
