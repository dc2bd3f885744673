"""`armsight snapshot`."""

from pathlib import Path
from typing import Annotated

import typer

from armsight_operator.cli.options import Connect, Namespace, ZenohConfig


def snapshot(
    folder: Annotated[Path, typer.Argument(help="Folder to write to; made if need be.")],
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Save one instant as files that `armsight-vision` measures without a bus.

    Example: armsight snapshot snap
    """
    from armsight_operator.cli.bus import configuration, connected
    from armsight_operator.errors import OperatorError
    from armsight_operator.picture import take_snapshot, write_snapshot
    from armsight_operator.picture.snapshot import CALIBRATION

    with connected(configuration(connect, namespace, zenoh_config)) as bus:
        taken = take_snapshot(bus)
    try:
        pictures = write_snapshot(taken, folder)
    except (OSError, ValueError) as error:
        raise OperatorError(f"no snapshot: {error}") from error
    images = " ".join(f"--image {name}={path}" for name, path in pictures.items())
    print(f"armsight-vision --calibration {folder / CALIBRATION} {images} --out {folder / 'found'}")
