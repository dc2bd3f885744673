"""The arm and its cameras as messages, read from the MuJoCo model: they are described nowhere else."""

import math

import mujoco
import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from armsight.times import to_timestamp
from armsight.v1.description_pb2 import (
    SHAPE_BOX,
    SHAPE_SPHERE,
    ArmDescription,
    Attachment,
    Body,
    Color,
    Joint,
    LinkShape,
    Marker,
)
from armsight.v1.geometry_pb2 import Quaternion, Transform, Vector3
from armsight_sim.errors import ModelError

Vector = npt.NDArray[np.float64]

_CYLINDER = mujoco.mjtGeom.mjGEOM_CYLINDER
_SPHERE = mujoco.mjtGeom.mjGEOM_SPHERE
_SHAPES = {int(_SPHERE): SHAPE_SPHERE, int(mujoco.mjtGeom.mjGEOM_BOX): SHAPE_BOX}


def describe_arm(model: mujoco.MjModel, with_bodies: bool = False) -> ArmDescription:
    """The description of the arm in its model, and of the bodies that move by themselves beside it when they are drawn.

    Raises:
        ModelError: the model does not follow the conventions of models/arm.xml.
    """
    first_body = int(model.jnt_bodyid[0])
    if model.body_parentid[first_body] != 0:
        raise ModelError("the first joint's body must be a child of the world")
    base = model.body_pos[first_body]
    description = ArmDescription(
        name=model.names.split(b"\0", 1)[0].decode(),
        world_from_base=Transform(translation=_vector3(base), rotation=Quaternion(w=1.0)),
        joints=[_joint(model, index) for index in range(model.njnt)],
        tip=_attachment(model, int(model.site("tip").bodyid[0]), model.site("tip").pos, base),
        cameras=camera_names(model),
    )
    for index in range(model.ngeom):
        name = model.geom(index).name
        body = int(model.geom_bodyid[index])
        if name.startswith("marker_"):
            if model.geom_type[index] != _SPHERE:
                raise ModelError(f"{name} must be a sphere")
            description.markers.append(
                Marker(
                    name=name.removeprefix("marker_"),
                    centre=_attachment(model, body, model.geom_pos[index], base),
                    radius_m=model.geom_size[index, 0],
                    color=_color(model, index),
                )
            )
        elif name == "base" or name.startswith("link_"):
            description.links.append(_link(model, index, base))
    if with_bodies:
        moved = [i for i in range(model.ngeom) if model.body_mocapid[model.geom_bodyid[i]] >= 0]
        description.bodies.extend(_body(model, index) for index in moved)
    if len({marker.name for marker in description.markers}) != len(description.markers) or not description.markers:
        raise ModelError("the model needs markers, each with a name of its own")
    return description


def camera_names(model: mujoco.MjModel) -> list[str]:
    """Names of the cameras, as on the bus."""
    return [model.camera(index).name for index in range(model.ncam)]


def calibration(model: mujoco.MjModel, camera: str, width: int, height: int, stamp_ns: int) -> CameraCalibration:
    """Calibration of an ideal pinhole camera, in OpenCV's convention (integer coordinates are pixel centres)."""
    focal = height / 2 / math.tan(math.radians(float(model.camera(camera).fovy[0])) / 2)
    cx, cy = (width - 1) / 2, (height - 1) / 2
    return CameraCalibration(
        timestamp=to_timestamp(stamp_ns),
        frame_id=optical_frame(camera),
        width=width,
        height=height,
        distortion_model="plumb_bob",
        D=[0.0] * 5,
        K=[focal, 0, cx, 0, focal, cy, 0, 0, 1],
        R=[1, 0, 0, 0, 1, 0, 0, 0, 1],
        P=[focal, 0, cx, 0, 0, focal, cy, 0, 0, 0, 1, 0],
    )


def camera_pose(model: mujoco.MjModel, camera: str, stamp_ns: int) -> FrameTransform:
    """T_world_optical of a camera: x right, y down, z into the scene (MuJoCo's own looks along −z with y up)."""
    index = model.camera(camera).id
    turned = np.zeros(4)
    mujoco.mju_mulQuat(turned, model.cam_quat[index], np.array([0.0, 1.0, 0.0, 0.0]))  # half a turn about x
    pose = FrameTransform(
        timestamp=to_timestamp(stamp_ns), parent_frame_id="world", child_frame_id=optical_frame(camera)
    )
    pose.translation.x, pose.translation.y, pose.translation.z = model.cam_pos[index]
    pose.rotation.w, pose.rotation.x, pose.rotation.y, pose.rotation.z = turned
    return pose


def optical_frame(camera: str) -> str:
    """Name of a camera's optical frame."""
    return f"camera_{camera}_optical"


def _joint(model: mujoco.MjModel, index: int) -> Joint:
    body = int(model.jnt_bodyid[index])
    if index > 0 and model.body_parentid[body] != model.jnt_bodyid[index - 1]:
        raise ModelError(f"{model.joint(index).name} must be a child of {model.joint(index - 1).name}: a serial chain")
    if np.any(model.jnt_pos[index] != 0) or np.any(model.body_quat[body] != (1, 0, 0, 0)):
        raise ModelError(f"{model.joint(index).name} must be at its body's origin, unturned at angle 0")
    lower, upper = model.jnt_range[index]
    return Joint(
        name=model.joint(index).name,
        # the base frame is the first joint's frame
        origin=_vector3(model.body_pos[body] if index > 0 else np.zeros(3)),
        axis=_vector3(model.jnt_axis[index]),
        lower_rad=lower,
        upper_rad=upper,
        max_speed_rad_s=model.jnt_user[index, 0],
    )


def _attachment(model: mujoco.MjModel, body: int, position: Vector, base: Vector) -> Attachment:
    joint = _joint_of_body(model, body)
    return Attachment(joint=joint, position=_vector3(position if joint else position - base))


def _joint_of_body(model: mujoco.MjModel, body: int) -> str:
    joints = [model.joint(index).name for index in range(model.njnt) if model.jnt_bodyid[index] == body]
    if body != 0 and len(joints) != 1:
        raise ModelError(f"body {model.body(body).name} must have one joint; it has {len(joints)}")
    return joints[0] if joints else ""


def _link(model: mujoco.MjModel, index: int, base: Vector) -> LinkShape:
    if model.geom_type[index] != _CYLINDER:
        raise ModelError(f"{model.geom(index).name} must be a cylinder")
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[index])
    radius, half_length, _ = model.geom_size[index]
    half = rotation.reshape(3, 3)[:, 2] * half_length
    body = int(model.geom_bodyid[index])
    start = _attachment(model, body, model.geom_pos[index] - half, base)
    end = _attachment(model, body, model.geom_pos[index] + half, base)
    return LinkShape(
        name=model.geom(index).name.removeprefix("link_"),
        joint=start.joint,
        start=start.position,
        end=end.position,
        radius_m=radius,
        color=_color(model, index),
    )


def _body(model: mujoco.MjModel, index: int) -> Body:
    name, shape = model.geom(index).name, _SHAPES.get(int(model.geom_type[index]))
    if shape is None:
        raise ModelError(f"{name} must be a sphere or a box")
    radius = model.geom_size[index, 0] if shape == SHAPE_SPHERE else 0.0
    return Body(name=name, shape=shape, radius_m=radius, color=_color(model, index))


def _color(model: mujoco.MjModel, geom: int) -> Color:
    material = int(model.geom_matid[geom])
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    return Color(red=rgba[0], green=rgba[1], blue=rgba[2])


def _vector3(values: Vector) -> Vector3:
    return Vector3(x=values[0], y=values[1], z=values[2])
