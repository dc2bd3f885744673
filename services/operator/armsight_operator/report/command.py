"""`armsight report`."""

import contextlib
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from armsight.session import SessionConfig
from armsight_operator.cli.bus import configuration, connected
from armsight_operator.cli.options import Connect, Namespace, ZenohConfig
from armsight_operator.errors import OperatorError
from armsight_operator.monitor import Monitor
from armsight_operator.recording.reader import Recording
from armsight_operator.report import from_recording, markers, measure, pages, plots, summary
from armsight_operator.report.run import Run, own_stack, wait_ready

_TEST_S = 60.0
# Holds the seam of joint 1 at +-pi, phi = +-pi/2 and a zero of phi (quick reports).
_QUICK_BEGIN_S, _QUICK_S = 8.0, 8.0
_IK_TARGETS, _IK_TARGETS_QUICK = 100, 15
_ROUTER_S = 20.0


def report(
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("report-out"),
    quick: Annotated[bool, typer.Option("--quick", help="8 s of each test instead of 60.")] = False,
    samples: Annotated[int, typer.Option(help="Samples a pixel: 0 or 4.")] = 4,
    seed: Annotated[int, typer.Option(help="Of the random configurations and targets.", min=0)] = 1,
    poses: Annotated[int, typer.Option(help="Random configurations of all joints to measure as well.", min=0)] = 0,
    noise: Annotated[float, typer.Option(help="Standard deviation of the frames' noise, grey levels.", min=0)] = 0.0,
    ambient: Annotated[str, typer.Option(help="Ambient light: 0 to 1, or 'sweep'.")] = "0.4",
    marker_light: Annotated[str, typer.Option("--markers", help="lit or emissive.")] = "lit",
    recordings: Annotated[
        list[Path] | None,
        typer.Option(
            "--from", metavar="FILE", help="Measure a recording instead; may be given again.", show_default=False
        ),
    ] = None,
    attach: Annotated[
        bool, typer.Option("--attach", help="Measure the running stack (lockstep), not one of our own.")
    ] = False,
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Measure the whole pipeline against the truth, as it runs or from a recording: tables and plots.

    Example: armsight report --quick

    Example: armsight report --from run.mcap
    """
    if samples not in (0, 4):
        raise typer.BadParameter("0 or 4", param_hint="--samples")
    if marker_light not in ("lit", "emissive"):
        raise typer.BadParameter("lit or emissive", param_hint="--markers")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OperatorError(f"can't write to {out}: {error.strerror}") from error
    began = time.monotonic()
    if recordings:
        recorded = from_recording.measure(Recording(*recordings))
        from_recording.write(recorded, out)
        print(*from_recording.headlines(recorded), sep="\n")
        print(f"written to {out}/report.html, report.md and summary.json in {time.monotonic() - began:.0f} s")
        return
    flags = ("--noise", f"{noise:g}", "--ambient", ambient, "--markers", marker_light)
    with contextlib.ExitStack() as stack:
        if attach:
            config = configuration(connect, namespace, zenoh_config)
        else:
            config = SessionConfig(
                endpoints=(stack.enter_context(own_stack(out, samples, flags)),), shared_memory="off"
            )
        bus = stack.enter_context(connected(config, _ROUTER_S))
        monitor = Monitor(bus)
        wait_ready(monitor)
        results = _measure(Run(bus, monitor), quick=quick, samples=samples, seed=seed, poses=poses)
    _write(results, out)
    figures = summary.to_json(results)
    print(f"table 1 MSE {figures['table1']['mse']:.2g} m² (report {figures['table1']['report_mse']:.3g})")
    for key in summary.TITLES:
        rms = ", ".join(f"{symbol} {1000 * value:.1f}" for symbol, value in figures[key]["rms"].items())
        print(f"{key} RMS, mrad: {rms}")
    print(f"written to {out}/report.html, report.md and summary.json in {time.monotonic() - began:.0f} s")


def _measure(run: Run, *, quick: bool, samples: int, seed: int, poses: int) -> summary.Results:
    begin_s, duration_s = (_QUICK_BEGIN_S, _QUICK_S) if quick else (0.0, _TEST_S)
    targets = _IK_TARGETS_QUICK if quick else _IK_TARGETS
    with _progress() as show:
        run.hold()
        rows = measure.table1(run, show("ten poses"))
        parts = {
            "part1": measure.part1(run, begin_s, duration_s, show("Part I")),
            "part2": measure.part2(run, begin_s, duration_s, show("Part II")),
            "all": measure.all_joints(run, begin_s, duration_s, show("all joints")),
        }
        run.hold()
        random = measure.random_poses(run, seed, poses, show("random poses")) if poses else None
        descents = measure.descents(run, seed, targets, show("inverse kinematics"))
    latencies = np.array(run.latencies_ms)
    return summary.Results(samples, quick, rows, parts, descents, latencies, random)


def _write(results: summary.Results, out: Path) -> None:
    plots.plot_table1(results.table1, out / "table1.png")
    for key, part in results.parts.items():
        plots.plot_part(part, out, key)
    samples = {key: part.markers for key, part in results.parts.items()}
    if results.random is not None:
        samples["random"] = results.random.markers
    markers.write_csv(samples, out / "markers.csv")
    pages.write(summary.to_markdown(results), summary.to_json(results), out)


@contextmanager
def _progress() -> Iterator[Callable[[str], measure.Progress]]:
    """A bar for each thing that is measured, on stderr; nothing where nobody looks."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description:20}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:

        def show(title: str) -> measure.Progress:
            if not console.is_terminal:
                console.print(f"measuring: {title}")
            task = bars.add_task(title, total=1.0)
            return lambda share: bars.update(task, completed=share)

        yield show
