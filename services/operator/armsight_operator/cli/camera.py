"""`armsight camera`: the camera service, in the place of this process."""

import os
import sys

import typer

PASSED_ON = {"ignore_unknown_options": True, "allow_extra_args": True}
"""Every other option than `--help` is the service's."""


def camera(context: typer.Context) -> None:
    """Bring cameras, videos or folders of pictures to the bus: runs `armsight-camera` with the same arguments.

    `armsight-camera --help` tells them all.

    Example: armsight camera --device 0 --device 1 --calibration calibration.json
    """
    from armsight_operator.stack.executables import find_executable

    executable = str(find_executable("camera"))
    sys.stdout.flush()
    os.execv(executable, [executable, *context.args])  # noqa: S606  (signals go to it, and its exit code is ours)
