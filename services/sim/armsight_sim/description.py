"""The arm and its cameras as messages, read from the MuJoCo model: they are described nowhere else."""

import math
from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from armsight.calibration import optical_frame
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
from armsight_sim import conventions
from armsight_sim.anatomy import Element, Kind, Places, balls, drawn_links, pose_in_world, rotation_of, shape_of, tip_of
from armsight_sim.errors import ModelError

Vector = npt.NDArray[np.float64]

_CYLINDER = mujoco.mjtGeom.mjGEOM_CYLINDER
_SPHERE = mujoco.mjtGeom.mjGEOM_SPHERE
_ROUND = tuple(map(int, (_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_ELLIPSOID)))
_LARGEST_LINK_M = 1e3
"""A plane's box is larger."""
_SHAPES = {int(_SPHERE): SHAPE_SPHERE, int(mujoco.mjtGeom.mjGEOM_BOX): SHAPE_BOX}


def describe_arm(
    model: mujoco.MjModel, with_bodies: bool = False, external_cameras: Sequence[str] = ()
) -> ArmDescription:
    """The description of the arm in its model.

    Args:
        model: of the arm.
        with_bodies: describe the bodies that move by themselves beside it, too: they are drawn.
        external_cameras: names of the cameras that see it, in the place of the model's.

    Raises:
        ModelError: the model does not follow the conventions; with everything that has to be mended.
    """
    conventions.check(model, with_cameras=not external_cameras)
    places, speeds = Places(model), conventions.max_speeds(model)
    tip = tip_of(model)
    assert tip is not None
    description = ArmDescription(
        name=model.names.split(b"\0", 1)[0].decode(),
        world_from_base=Transform(translation=_vector3(places.p_world_base), rotation=_quaternion(places.R_world_base)),
        joints=[_joint(model, places, speeds, index) for index in range(model.njnt)],
        tip=_attachment(model, places, *tip),
        cameras=external_cameras or camera_names(model),
    )
    for ball in balls(model):
        position, size = shape_of(model, ball)
        description.markers.append(
            Marker(
                name=ball.name,
                centre=_attachment(model, places, ball.body, position),
                radius_m=size[0],
                color=_color(model, ball),
            )
        )
    for link in drawn_links(model):
        description.links.extend(_link(model, places, link))
    if with_bodies:
        moved = [i for i in range(model.ngeom) if model.body_mocapid[model.geom_bodyid[i]] >= 0]
        description.bodies.extend(_body(model, index) for index in moved)
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
    turned, position = np.zeros(4), model.cam_pos[index]
    mujoco.mju_mulQuat(turned, model.cam_quat[index], np.array([0.0, 1.0, 0.0, 0.0]))  # half a turn about x
    if model.cam_bodyid[index] != 0:
        stands, rotation = pose_in_world(model, int(model.cam_bodyid[index]))
        position, body, own = stands + rotation @ position, np.zeros(4), turned.copy()
        mujoco.mju_mat2Quat(body, rotation.ravel())
        mujoco.mju_mulQuat(turned, body, own)
    pose = FrameTransform(
        timestamp=to_timestamp(stamp_ns), parent_frame_id="world", child_frame_id=optical_frame(camera)
    )
    pose.translation.x, pose.translation.y, pose.translation.z = position
    pose.rotation.w, pose.rotation.x, pose.rotation.y, pose.rotation.z = turned
    return pose


def _joint(model: mujoco.MjModel, places: Places, speeds: Vector, index: int) -> Joint:
    lower, upper = model.jnt_range[index]
    return Joint(
        name=model.joint(index).name,
        origin=_vector3(places.origins[index]),
        axis=_vector3(places.axes[index]),
        lower_rad=lower,
        upper_rad=upper,
        max_speed_rad_s=speeds[index],
    )


def _attachment(model: mujoco.MjModel, places: Places, body: int, position: Vector) -> Attachment:
    joint, place = places.attached(body, position)
    return Attachment(joint=model.joint(joint).name if joint >= 0 else "", position=_vector3(place))


def _link(model: mujoco.MjModel, places: Places, element: Element) -> list[LinkShape]:
    """The cylinder that is a geom, or that is around it; none for what has no size, such as a plane."""
    index, kind = element.index, model.geom_type[element.index]
    if kind == _CYLINDER:
        radius, half_length, _ = model.geom_size[index]
        centre, axis = model.geom_pos[index], rotation_of(model.geom_quat[index])[:, 2]
    else:
        # the box around it, in the geom's frame: its longest side is the cylinder's axis
        middle, halves = model.geom_aabb[index, :3], model.geom_aabb[index, 3:]
        if not (0 < halves.max() < _LARGEST_LINK_M):
            return []
        rotation, along = rotation_of(model.geom_quat[index]), int(np.argmax(halves))
        centre, axis, half_length = model.geom_pos[index] + rotation @ middle, rotation[:, along], halves[along]
        across = np.delete(halves, along)
        radius = float(across.max() if int(kind) in _ROUND else np.hypot(*across))
    half = axis * half_length
    start = _attachment(model, places, element.body, centre - half)
    end = _attachment(model, places, element.body, centre + half)
    return [
        LinkShape(
            name=element.name,
            joint=start.joint,
            start=start.position,
            end=end.position,
            radius_m=radius,
            color=_color(model, element),
        )
    ]


def _body(model: mujoco.MjModel, index: int) -> Body:
    name, shape = model.geom(index).name, _SHAPES.get(int(model.geom_type[index]))
    if shape is None:
        raise ModelError(f"{name} must be a sphere or a box")
    radius = model.geom_size[index, 0] if shape == SHAPE_SPHERE else 0.0
    element = Element(Kind.GEOM, index, name, name, int(model.geom_bodyid[index]))
    return Body(name=name, shape=shape, radius_m=radius, color=_color(model, element))


def _color(model: mujoco.MjModel, element: Element) -> Color:
    red, green, blue = conventions.color_of(model, element)
    return Color(red=red, green=green, blue=blue)


def _quaternion(rotation: Vector) -> Quaternion:
    found = np.zeros(4)
    mujoco.mju_mat2Quat(found, rotation.ravel())
    w, x, y, z = found
    return Quaternion(w=w, x=x, y=y, z=z)


def _vector3(values: Vector) -> Vector3:
    return Vector3(x=values[0], y=values[1], z=values[2])
