"""The simulated arm: a MuJoCo model that follows a setpoint.

Angles are in radians, in the order of :attr:`World.joint_names`; times in simulated seconds.
"""

import copy
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt

from armsight_sim import conventions
from armsight_sim.anatomy import moves
from armsight_sim.errors import ModelError, PoseError

Vector = npt.NDArray[np.float64]

LIMIT_TOLERANCE_RAD = 1e-6
"""Rounding of another service is clamped, anything further is refused."""

_LONG = (int(mujoco.mjtGeom.mjGEOM_CYLINDER), int(mujoco.mjtGeom.mjGEOM_CAPSULE))
_LONGEST_STEP_S = 0.0021  # sixteen steps a frame at 30 Hz: kv of the actuators is stable with room to spare


def load_model(file: Path | None = None) -> mujoco.MjModel:
    """A model, as it is: an MJCF or a URDF, with what it refers to beside it; without a file the arm of this package.

    Raises:
        ModelError: there is no such file, or MuJoCo can't read it.
    """
    if file is None:
        return mujoco.MjModel.from_xml_string(resources.files("armsight_sim").joinpath("models/arm.xml").read_text())
    if not file.is_file():
        raise ModelError(f"there is no model {file}")
    try:
        return mujoco.MjModel.from_xml_path(str(file))
    except ValueError as error:
        raise ModelError(f"MuJoCo can't read {file}: {' '.join(str(error).split())}") from error


def longer_links(model: mujoco.MjModel, share: float) -> mujoco.MjModel:
    """The same arm with links that are longer by a share of their length than the model describes them.

    Everything on a moving body is farther along it by that share: the next joint, what is drawn, the tip. Masses stay.
    """
    other = copy.copy(model)
    scale = 1.0 + share
    moving = [body for body in range(model.nbody) if moves(model, body)]
    for body in moving:
        other.jnt_pos[model.jnt_bodyid == body] *= scale
        if moves(model, int(model.body_parentid[body])):
            other.body_pos[body] *= scale
    for geom in np.flatnonzero(np.isin(model.geom_bodyid, moving)):
        other.geom_pos[geom] *= scale
        if int(model.geom_type[geom]) in _LONG:
            other.geom_size[geom, 1] *= scale
    other.site_pos[np.isin(model.site_bodyid, moving)] *= scale
    return other


class World:
    """Model and state; nothing in here knows of cameras or of the bus."""

    def __init__(self, model: mujoco.MjModel, frame_period_s: float, *, with_cameras: bool = True) -> None:
        """At rest at the zero pose.

        Args:
            model: its step is set to divide the frame period.
            frame_period_s: simulated time between two frames.
            with_cameras: whether the model must have them.

        Raises:
            ModelError: the model does not follow the conventions of docs/own-arm.md; with everything to be mended.
        """
        conventions.check(model, with_cameras=with_cameras)
        self.model = model
        self.data = mujoco.MjData(model)
        self.steps_per_frame = int(np.ceil(frame_period_s / _LONGEST_STEP_S))
        model.opt.timestep = self.step_s = frame_period_s / self.steps_per_frame
        self.joint_names = tuple(model.joint(index).name for index in range(model.njnt))
        self._actuators = [conventions.actuators_of(model, joint)[0] for joint in range(model.njnt)]
        self.limits: npt.NDArray[np.float64] = model.jnt_range.copy()
        self.max_speed: Vector = conventions.max_speeds(model)
        # A position actuator pulls with kp (ctrl - q) - kv q'. Adding kv/kp of the setpoint's speed to ctrl makes that
        # kp (setpoint - q) + kv (setpoint' - q'): no lag behind a moving setpoint. A joint's own damping adds to kv.
        bias = model.actuator_biasprm[self._actuators]
        self._lead_s: Vector = (bias[:, 2] - model.dof_damping) / bias[:, 1]
        self.reset(np.zeros(len(self.joint_names)))

    def reset(self, pose: Vector) -> None:
        """Puts the arm at a pose, at rest."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = pose
        self.data.ctrl[self._actuators] = pose
        mujoco.mj_forward(self.model, self.data)

    def step(self, setpoint: Vector, setpoint_speed: Vector) -> None:
        """One step of :attr:`step_s` towards a moving setpoint (rad, rad/s)."""
        self.data.ctrl[self._actuators] = setpoint + self._lead_s * setpoint_speed
        mujoco.mj_step(self.model, self.data)
        # mj_step leaves positions of bodies one step behind the angles: a moving arm would be drawn where it was
        self.update_positions()

    def update_positions(self) -> None:
        """Recomputes where everything is after a change to the scene (the visible target)."""
        mujoco.mj_kinematics(self.model, self.data)

    def angles(self) -> Vector:
        """The true joint angles."""
        return np.array(self.data.qpos)

    def speeds(self) -> Vector:
        """The true joint speeds, rad/s."""
        return np.array(self.data.qvel)

    def pose(self, named: Mapping[str, float]) -> Vector:
        """Angles by name as a vector; joints left out are at 0.

        Raises:
            PoseError: an unknown joint, an angle that is not finite or beyond its limits.
        """
        unknown = sorted(set(named) - set(self.joint_names))
        if unknown:
            raise PoseError(f"no joint {', '.join(map(repr, unknown))}; this arm has {', '.join(self.joint_names)}")
        return self.within_limits([named.get(name, 0.0) for name in self.joint_names])

    def within_limits(self, angles: Sequence[float]) -> Vector:
        """The angles, clamped if no more than rounding beyond the limits.

        Raises:
            PoseError: an angle that is not finite or further out.
        """
        pose = np.array(angles, dtype=float)
        for name, angle, (lower, upper) in zip(self.joint_names, pose, self.limits, strict=True):
            if not np.isfinite(angle):
                raise PoseError(f"{name} = {angle} is not a finite angle")
            if not lower - LIMIT_TOLERANCE_RAD <= angle <= upper + LIMIT_TOLERANCE_RAD:
                raise PoseError(f"{name} = {angle:.6g} rad is outside of its limits [{lower:.6g}, {upper:.6g}]")
        return np.asarray(np.clip(pose, self.limits[:, 0], self.limits[:, 1]))
