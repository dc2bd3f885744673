"""Which of control's settings may be changed while it runs.

Speed only up to what control was started with, and neither acceleration nor jerk: every step that was taken has left
room to brake by them.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from armsight.parameters import Tunable, Value
from armsight_control import estimators
from armsight_control.aiming import FREE_JOINTS
from armsight_control.detour import KEEP_M
from armsight_control.movement import MotionOptions
from armsight_control.settings import Settings
from armsight_control.solvers import SOLVERS
from armsight_control.solvers.start import INITIALISATIONS


def tunables(settings: Settings) -> tuple[Tunable, ...]:
    """The settings that may be changed, from those that control starts with."""
    way, most = settings.way, settings.motion.speed_share
    return (
        Tunable("speed", "share of the joints' speed, at most --speed", most, "", min(0.01, most), most),
        Tunable(
            "estimator", "of the joints' angles", settings.estimator, choices=_and(estimators.NAMES, settings.estimator)
        ),
        Tunable("solver", "of inverse kinematics", settings.solver, choices=_and(SOLVERS, settings.solver)),
        Tunable(
            "initialisation",
            "start of a query for inverse kinematics that gives none",
            settings.initialisation,
            choices=INITIALISATIONS,
        ),
        Tunable(
            "free_joints",
            "of track and follow: 3 keeps joint 2 at 0; other arms move all",
            way.free_joints,
            choices=tuple(FREE_JOINTS),
        ),
        Tunable("avoid_box", f"keep every link {KEEP_M:g} m from the centre of the box", way.avoid_box),
        Tunable("standoff_m", "of the tip from the sphere in follow", way.standoff_m, "m", 0.5, 2.0),
        Tunable(
            "correction_time_s",
            "in which what differs between tip as seen and tip as commanded is corrected",
            way.correction_time_s,
            "s",
            0.05,
            10.0,
        ),
    )


def _and(ours: Iterable[str], own: str) -> tuple[str, ...]:
    """Ours, and the part of a person's own that control was started with: no other is imported."""
    return tuple(dict.fromkeys((*ours, own)))


def tuned(settings: Settings, values: Mapping[str, Value]) -> Settings:
    """The settings with new values, each checked by its :class:`~armsight.parameters.Tunable`."""
    of: dict[str, Any] = dict(values)
    return replace(
        settings,
        estimator=of["estimator"],
        solver=of["solver"],
        initialisation=of["initialisation"],
        way=MotionOptions(
            free_joints=of["free_joints"],
            avoid_box=of["avoid_box"],
            slow=of["speed"] / settings.motion.speed_share,
            standoff_m=of["standoff_m"],
            correction_time_s=of["correction_time_s"],
        ),
    )
