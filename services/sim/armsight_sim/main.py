"""The executable armsight-sim: checks flags, finds a way to draw, runs the service."""

import logging
import sys

from armsight.errors import ArmsightError, ConfigError
from armsight.service import EXIT_CONFIG, Context, run_service
from armsight.shared_memory import Use
from armsight.v1.health_pb2 import HEALTH_STATUS_WAITING
from armsight_sim.errors import PoseError
from armsight_sim.gl import choose_gl, draw_nothing
from armsight_sim.settings import Settings, argument_parser, parse_settings

log = logging.getLogger(__name__)


def main() -> int:
    """Returns the exit code: 0 when asked to stop, 2 where flags or the machine do not allow to start."""
    arguments = argument_parser().parse_args()
    try:
        settings = parse_settings(arguments)
        gl = None
        if not arguments.health:
            if settings.external_cameras:
                draw_nothing()
            else:
                gl = choose_gl()
            check_model(settings)
    except ArmsightError as error:
        print(f"sim: {error}", file=sys.stderr)
        return EXIT_CONFIG

    def body(context: Context) -> None:
        from armsight_sim.service import Simulation  # imports MuJoCo: not before choose_gl

        drawing = f"drawing by {gl}" if gl else "drawing nothing"
        log.info(drawing)
        context.health.report(HEALTH_STATUS_WAITING, f"loading the model, {drawing}")
        Simulation(context, settings, is_software=gl is not None and gl.is_software).run()

    # of the frames' memory there is one: it is made by who has the cameras
    memory: Use = "read" if settings.external_cameras else "publish"
    return run_service("sim", arguments, settings, body, shared_memory=memory)


def check_model(settings: Settings) -> None:
    """Refuses a model, a target or a start pose that can't be used, before anything is on the bus.

    Raises:
        ModelError: the model does not follow the conventions.
        ConfigError: the target needs bodies that the model hasn't; not one angle for each joint, within its limits; the
            calibration file does not fit to the model.
    """
    if settings.model is None and not settings.pose and settings.calibration is None:
        return  # what this package ships is tested
    from armsight_sim.recalibration import recalibration_of
    from armsight_sim.tip_path import check_target
    from armsight_sim.world import World, load_model  # imports MuJoCo: not before choose_gl

    model = load_model(settings.model)
    world = World(model, 1.0, with_cameras=not settings.external_cameras)
    check_target(model, settings.target)
    recalibration_of(settings, model)
    if not settings.pose:
        return
    if len(settings.pose) != len(world.joint_names):
        raise ConfigError(f"--pose has {len(settings.pose)} angles; this arm has {', '.join(world.joint_names)}")
    try:
        world.within_limits(settings.pose)
    except PoseError as error:
        raise ConfigError(f"--pose: {error}") from error


if __name__ == "__main__":
    sys.exit(main())
