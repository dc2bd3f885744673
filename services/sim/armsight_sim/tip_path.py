"""A moving target for any arm: a closed path of the tip through configurations well inside the limits.

Every joint swings about one configuration; the tip's way follows by forward kinematics, so that every point of it is
in reach. The configuration is the best of some drawn from a fixed seed: markers in view, and the tip free to move in
every direction.
"""

import math
from collections.abc import Callable

import mujoco
import numpy as np

from armsight.errors import ConfigError
from armsight_sim.anatomy import Places, balls, place_of, shape_of, tip_of
from armsight_sim.conventions import max_speeds, size_of
from armsight_sim.description import describe_arm
from armsight_sim.targets import TARGETS, VISIBLE, Point
from armsight_sim.world import Vector, load_model

DEFAULT = "default"
SPHERE, BOX = "target_sphere", "target_box"
"""The bodies of the target `visible`."""

PERIOD_S = 20.0
# Of a joint's range to either side, and at most: the tip's own speed stays that of a target to follow.
_SHARE, _MOST_RAD = 0.2, 0.25
# Of a joint's speed: control keeps a reserve to catch up.
_SPEED_SHARE = 0.1
_CANDIDATES, _SAMPLES = 64, 8
# Where candidates lie: the middle half of each range leaves the swing well inside the limits.
_MIDDLE = 0.5
_DRAWN_GROUPS = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8)


def targets_of(model: mujoco.MjModel) -> dict[str, tuple[str, Callable[[float], Point]]]:
    """By name the frame and the point of every target: of an arm that is not our own, with a `default` of its own."""
    if describe_arm(model) == describe_arm(load_model()):
        return TARGETS
    return TARGETS | {DEFAULT: ("base", TipPath(model))}


def check_target(model: mujoco.MjModel, target: str) -> None:
    """Refuses a target that needs bodies which a model does not have.

    Raises:
        ConfigError: says which.
    """
    if target == VISIBLE and mocap_rows(model) is None:
        raise ConfigError(
            f"--target {VISIBLE}: this model has no bodies {SPHERE} and {BOX}, each with mocap and one geom of its name"
        )


def mocap_rows(model: mujoco.MjModel) -> tuple[int, int] | None:
    """Where the places of the sphere and the box are set; nothing where the model has not both, and no others."""
    names = [model.body(index).name for index in range(model.nbody) if model.body_mocapid[index] >= 0]
    geoms = {model.geom(index).name for index in range(model.ngeom)}
    if sorted(names) != [BOX, SPHERE] or not {SPHERE, BOX} <= geoms:
        return None
    return int(model.body(SPHERE).mocapid[0]), int(model.body(BOX).mocapid[0])


class TipPath:
    """The tip's way, base frame, metres, as a function of time in seconds."""

    def __init__(self, model: mujoco.MjModel) -> None:
        """Chooses the configuration to swing about: some 0.1 s."""
        self._model, self._data, self._places = model, mujoco.MjData(model), Places(model)
        self._tip, self._balls = tip_of(model), balls(model)
        middle, half = model.jnt_range.mean(axis=1), np.ptp(model.jnt_range, axis=1) / 2
        self._swing = np.minimum(_SHARE * half, _MOST_RAD)
        self._turns = 1.0 + np.arange(model.njnt) % 2
        fastest = self._swing * self._turns * 2 * math.pi / PERIOD_S
        self.period_s = PERIOD_S * max(1.0, float((fastest / (_SPEED_SHARE * max_speeds(model))).max()))
        drawn = np.random.default_rng(0).uniform(-_MIDDLE, _MIDDLE, (_CANDIDATES, model.njnt))
        candidates = middle + drawn * half
        self.centre: Vector = max(candidates, key=self._worth)

    def __call__(self, t: float) -> Point:
        """Where the tip is at a time."""
        self._data.qpos[:] = self.angles(self.centre, t)
        mujoco.mj_kinematics(self._model, self._data)
        x, y, z = self._places.R_world_base.T @ (self._tip_world() - self._places.p_world_base)
        return float(x), float(y), float(z)

    def angles(self, centre: Vector, t: float) -> Vector:
        """All joints on the way about a configuration, radians."""
        phases = np.arange(len(centre)) * 2.0
        return np.asarray(centre + self._swing * np.sin(2 * math.pi * self._turns * t / self.period_s + phases))

    def _worth(self, centre: Vector) -> float:
        least, seen = math.inf, 0.0
        for t in np.linspace(0.0, self.period_s, _SAMPLES, endpoint=False):
            self._look_at(self.angles(centre, float(t)))
            least = min(least, self._freedom())
            seen += self._share_seen() / _SAMPLES
        return seen * seen * least

    def _look_at(self, q: Vector) -> None:
        """Takes a configuration, with all that judging it needs."""
        self._data.qpos[:] = q
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)

    def _tip_world(self) -> Vector:
        assert self._tip is not None
        body, place = self._tip
        return np.asarray(self._data.xpos[body] + self._data.xmat[body].reshape(3, 3) @ place)

    def _freedom(self) -> float:
        """The least that the tip moves in any direction, metres per radian."""
        assert self._tip is not None
        jacobian = np.zeros((3, self._model.nv))
        mujoco.mj_jac(self._model, self._data, jacobian, None, self._tip_world(), self._tip[0])
        return float(np.linalg.svd(jacobian, compute_uv=False)[-1])

    def _share_seen(self) -> float:
        """Of the markers, those that two cameras see, or the only one there is."""
        model, data = self._model, self._data
        views = 0.0
        for ball in self._balls:
            place, radius = place_of(data, ball), float(shape_of(model, ball)[1][0])
            looks = sum(self._sees(camera, place, radius) for camera in range(model.ncam))
            views += min(1.0, looks / min(2, model.ncam))
        return views / len(self._balls)

    def _sees(self, camera: int, place: Vector, radius_m: float) -> bool:
        model, data = self._model, self._data
        eye, turned = data.cam_xpos[camera], data.cam_xmat[camera].reshape(3, 3)
        x, y, z = turned.T @ (place - eye)
        width, height = size_of(model, camera) or (1, 1)
        half = math.tan(math.radians(float(model.cam_fovy[camera])) / 2) * -z
        if z >= 0 or abs(y) > half or abs(x) > half * width / height:
            return False
        way = place - eye
        distance = float(np.linalg.norm(way))
        hit = np.zeros(1, dtype=np.int32)
        to_hit = mujoco.mj_ray(model, data, eye, way / distance, _DRAWN_GROUPS, 1, -1, hit)
        return bool(to_hit < 0 or to_hit >= distance - 1.01 * radius_m)
