"""The executable armsight-sim: checks flags, finds a way to draw, runs the service."""

import logging
import sys

from armsight.errors import ArmsightError
from armsight.service import EXIT_CONFIG, Context, run_service
from armsight.v1.health_pb2 import HEALTH_STATUS_WAITING
from armsight_sim.gl import choose_gl
from armsight_sim.settings import argument_parser, parse_settings

log = logging.getLogger(__name__)


def main() -> int:
    """Returns the exit code: 0 when asked to stop, 2 where flags or the machine do not allow to start."""
    arguments = argument_parser().parse_args()
    try:
        settings = parse_settings(arguments)
        gl = "" if arguments.health else choose_gl()
    except ArmsightError as error:
        print(f"sim: {error}", file=sys.stderr)
        return EXIT_CONFIG

    def body(context: Context) -> None:
        from armsight_sim.service import Simulation  # imports MuJoCo: not before choose_gl

        log.info("drawing off screen", extra={"gl": gl})
        context.health.report(HEALTH_STATUS_WAITING, f"loading the model, drawing by {gl}")
        Simulation(context, settings).run()

    return run_service("sim", arguments, settings, body, shared_memory="publish")


if __name__ == "__main__":
    sys.exit(main())
