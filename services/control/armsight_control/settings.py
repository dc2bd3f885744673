"""The configuration of the service, from its flags."""

import argparse
from dataclasses import dataclass

from armsight.service import add_service_arguments
from armsight_control import estimators
from armsight_control.aiming import FREE_JOINTS
from armsight_control.detour import KEEP_M
from armsight_control.errors import ControlError
from armsight_control.modes import INITIAL_NAMES
from armsight_control.movement import MotionOptions
from armsight_control.solvers import SOLVERS, check_solver
from armsight_control.solvers.options import GradientDescentOptions, Options
from armsight_control.solvers.start import INITIALISATIONS, Initialisation
from armsight_control.trajectory import MotionLimits


@dataclass(frozen=True, slots=True)
class Settings:
    """What is in force; answered on `control/parameters`."""

    mode: str
    estimator: str
    solver: str
    initialisation: Initialisation
    seed: int
    ik: Options
    motion: MotionLimits
    way: MotionOptions

    def __post_init__(self) -> None:
        """Refuses what can't work; imports parts of a person's own."""
        estimators.check_estimator(self.estimator)
        check_solver(self.solver)
        if self.seed < 0:
            raise ControlError(f"seed {self.seed} is below 0")


def parser() -> argparse.ArgumentParser:
    """The flags of `armsight-control`."""
    defaults, motion, way = GradientDescentOptions(), MotionLimits(), MotionOptions()
    flags = argparse.ArgumentParser(
        prog="armsight-control",
        description="Turns joint positions into joint angles and commands the joints; runs until SIGTERM.",
    )
    add_service_arguments(flags)
    control = flags.add_argument_group("control")
    control.add_argument("--mode", choices=INITIAL_NAMES, default="hold", help="mode to begin with (default: hold)")
    control.add_argument(
        "--estimator",
        default=estimators.all_joints.NAME,
        metavar="NAME",
        help=f"of the joints' angles: {', '.join(estimators.NAMES)}, or your own: module:Class or file.py:Class "
        "(default: %(default)s)",
    )
    control.add_argument(
        "--speed", type=float, default=motion.speed_share, help="share of the joints' speed (default: %(default)s)"
    )
    control.add_argument(
        "--acceleration",
        type=float,
        default=motion.acceleration_rad_s2,
        help="of each joint, rad/s² (default: %(default)s)",
    )
    control.add_argument(
        "--jerk", type=float, default=motion.jerk_rad_s3, help="of each joint, rad/s³ (default: %(default)s)"
    )
    control.add_argument(
        "--free-joints",
        choices=FREE_JOINTS,
        default=way.free_joints,
        help="of track and follow: 3 keeps joint 2 at 0 as the report does, all uses it; other arms than the report's "
        "always use all (default: %(default)s)",
    )
    control.add_argument(
        "--avoid-box",
        action="store_true",
        help=f"keep every link {KEEP_M:g} m from the centre of the box that vision sees",
    )
    control.add_argument(
        "--seed", type=int, default=0, help="of all random numbers, so that runs repeat (default: %(default)s)"
    )
    ik = flags.add_argument_group("inverse kinematics")
    ik.add_argument(
        "--solver",
        default="torch",
        metavar="NAME",
        help=f"{', '.join(SOLVERS)}, or your own: module:function or file.py:function (default: %(default)s)",
    )
    ik.add_argument(
        "--initialisation",
        choices=INITIALISATIONS,
        default="random",
        help="start of a query that gives none; track always goes on from its last solution (default: %(default)s)",
    )
    report = flags.add_argument_group("the solver gradient-descent")
    report.add_argument("--alpha", type=float, default=defaults.alpha, help="step size (default: %(default)s)")
    report.add_argument(
        "--tolerance", type=float, default=defaults.tolerance_m, help="mean absolute error, m (default: %(default)s)"
    )
    report.add_argument(
        "--max-steps", type=int, default=defaults.max_steps, help="of one descent (default: %(default)s)"
    )
    return flags


def settings_of(arguments: argparse.Namespace) -> Settings:
    """Checks the flags.

    Raises:
        ControlError: a value that can't work.
    """
    descent = GradientDescentOptions(
        alpha=arguments.alpha, tolerance_m=arguments.tolerance, max_steps=arguments.max_steps
    )
    return Settings(
        mode=arguments.mode,
        estimator=arguments.estimator,
        solver=arguments.solver,
        initialisation=arguments.initialisation,
        seed=arguments.seed,
        ik=Options(gradient_descent=descent),
        motion=MotionLimits(
            speed_share=arguments.speed,
            acceleration_rad_s2=arguments.acceleration,
            jerk_rad_s3=arguments.jerk,
        ),
        way=MotionOptions(free_joints=arguments.free_joints, avoid_box=arguments.avoid_box),
    )
