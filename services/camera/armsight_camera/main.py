"""The executable armsight-camera: checks flags, calibrations and files, runs the service."""

import logging
import os
import sys

from armsight.errors import ArmsightError, ConfigError
from armsight.service import EXIT_CONFIG, Context, run_service
from armsight_camera.settings import Settings, argument_parser, parse_settings


def main() -> int:
    """Returns the exit code: 0 when asked to stop or all files were sent, 2 where flags or files do not allow that."""
    arguments = argument_parser().parse_args()
    if arguments.health:
        return run_service("camera", arguments, None, lambda _: None)
    try:
        settings = parse_settings(arguments)
        check_files(settings)
    except ArmsightError as error:
        print(f"camera: {error}", file=sys.stderr)
        return EXIT_CONFIG
    stuck = False

    def body(context: Context) -> None:
        from armsight_camera.service import Cameras

        nonlocal stuck
        cameras = Cameras(context, settings)
        try:
            cameras.run()
        finally:
            stuck = cameras.stuck

    code = run_service("camera", arguments, settings.parameters(), body, shared_memory="publish")
    if stuck:
        # a thread that returns from its driver into an interpreter that has ended aborts the process
        logging.shutdown()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return code


def check_files(settings: Settings) -> None:
    """Refuses files that can't be read or have another size than was calibrated, before anything is on the bus.

    Raises:
        ConfigError: one can't be decoded.
        SizeError: one has another size.
    """
    from armsight_camera.capture import check_size
    from armsight_camera.errors import SourceError
    from armsight_camera.source import open_source

    for device in settings.devices:
        if not device.ends:
            continue
        wanted = settings.wanted[device.name]
        try:
            source = open_source(device, wanted)
        except SourceError as error:
            raise ConfigError(f"{device}: {error}") from error
        try:
            size = source.size() if source.grab() else None
        finally:
            source.close()
        if size is None:
            raise ConfigError(f"{device}: none of its pictures can be decoded")
        check_size(device, wanted, size)


if __name__ == "__main__":
    sys.exit(main())
