"""Whether a MuJoCo model follows the conventions by which everybody gets to know the arm: all that is wrong at once.

They are told in docs/own-arm.md and, by example, in models/arm.xml.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from armsight.topics import NAME
from armsight_sim.anatomy import MARKER, Element, Kind, Places, balls, carrier, moves, place_of, shape_of, tip_of
from armsight_sim.errors import ModelError
from armsight_sim.settings import LEAST_SIDE_PX, MOST_SIDE_PX

# What vision needs to tell colours apart (services/vision_cpp/src/classify.cpp).
LEAST_HUE_DISTANCE_RAD = math.radians(12)
LEAST_SATURATION = 0.15
MOST_MARKERS, MOST_CAMERAS = 64, 16

_HINGE = mujoco.mjtJoint.mjJNT_HINGE
_SPHERE = mujoco.mjtGeom.mjGEOM_SPHERE
_OWN_COLOR = "give it a colour far from grey: rgba of its own, or a material"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is not as it should be."""

    what: str
    mend: str
    breaks: bool = True
    """Whether the arm can't be used before it is mended; else it works, but less well."""


def findings(model: mujoco.MjModel, *, with_cameras: bool = True) -> list[Finding]:
    """Everything that is missing or wrong, in the order of docs/own-arm.md.

    Args:
        model: of an arm.
        with_cameras: whether its cameras are used.
    """
    chain = list(_chain(model))
    return [
        *chain,
        *_joints(model),
        *_actuators(model),
        *_tip(model),
        *_markers(model),
        *([] if chain else _seen(model)),
        *(_cameras(model) if with_cameras else ()),
        *_weight(model),
    ]


def check(model: mujoco.MjModel, *, with_cameras: bool = True) -> None:
    """Refuses a model that can't be used.

    Args:
        model: of an arm.
        with_cameras: whether its cameras are used.

    Raises:
        ModelError: with everything that has to be mended.
    """
    wrong = [
        f"{finding.what}: {finding.mend}" for finding in findings(model, with_cameras=with_cameras) if finding.breaks
    ]
    if wrong:
        raise ModelError("; ".join(wrong))


def max_speeds(model: mujoco.MjModel) -> np.ndarray:
    """Of every joint, rad/s: its own `user` value, else that of its actuator; 0 where there is neither."""
    speeds = np.zeros(model.njnt)
    for joint in range(model.njnt):
        own = model.jnt_user[joint, 0] if model.nuser_jnt else 0.0
        if own == 0.0 and model.nuser_actuator:
            own = max((model.actuator_user[a, 0] for a in actuators_of(model, joint)), default=0.0)
        speeds[joint] = own
    return speeds


def actuators_of(model: mujoco.MjModel, joint: int) -> list[int]:
    """The actuators that drive a joint."""
    driven = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    return [int(a) for a in np.flatnonzero(driven & (model.actuator_trnid[:, 0] == joint))]


def color_of(model: mujoco.MjModel, element: Element) -> np.ndarray:
    """Red, green and blue, 0 to 1, of an element as it is drawn."""
    geom = element.kind is Kind.GEOM
    material = int((model.geom_matid if geom else model.site_matid)[element.index])
    own = (model.geom_rgba if geom else model.site_rgba)[element.index]
    return np.asarray((model.mat_rgba[material] if material >= 0 else own)[:3], dtype=np.float64)


def size_of(model: mujoco.MjModel, camera: int) -> tuple[int, int] | None:
    """Columns and rows that a camera's `resolution` asks for; nothing where it says none."""
    width, height = map(int, model.cam_resolution[camera])
    return None if width == height == 1 else (width, height)


def _chain(model: mujoco.MjModel) -> Iterator[Finding]:
    if model.njnt == 0:
        yield Finding("the model has no joints", "give each moving body one hinge joint")
        return
    for joint in range(model.njnt):
        name, body = _joint_name(model, joint), int(model.jnt_bodyid[joint])
        if model.jnt_type[joint] != _HINGE:
            yield Finding(
                f"{name} is no hinge", "an arm is a chain of hinge joints: weld or remove what slides or floats"
            )
        if model.body_jntnum[body] != 1 and model.body_jntadr[body] == joint:
            mend = "give each joint a body of its own (a body without geoms needs an <inertial>)"
            yield Finding(f"body {model.body(body).name} has {model.body_jntnum[body]} joints", mend)
        below = carrier(model, int(model.body_parentid[body]))
        if joint > 0 and model.body_jntnum[body] == 1 and below != joint - 1:
            before = _joint_name(model, joint - 1)
            mend = f"put its body into that of {before}; weld or remove other branches, such as fingers"
            yield Finding(f"{name} does not come after {before}: the arm is one serial chain", mend)


def _joints(model: mujoco.MjModel) -> Iterator[Finding]:
    speeds = max_speeds(model)
    for joint in range(model.njnt):
        name = _joint_name(model, joint)
        if not model.joint(joint).name:
            yield Finding(f"{name} has no name", 'give it one: name="shoulder"')
        if not model.jnt_limited[joint]:
            yield Finding(f"{name} has no limits", 'give it a range, in radians with <compiler angle="radian"/>')
        if not speeds[joint] > 0:
            mend = 'say how fast it may turn, rad/s: user="2" with <size nuser_jnt="1"/>, or user of its actuator'
            yield Finding(f"{name} has no speed", mend)
        if model.jnt_type[joint] == _HINGE and model.qpos0[model.jnt_qposadr[joint]] != 0:
            yield Finding(f"{name} has a ref", "remove it: angle 0 is where the model is drawn")


def _actuators(model: mujoco.MjModel) -> Iterator[Finding]:
    driving: set[int] = set()
    for joint in range(model.njnt):
        name, found = _joint_name(model, joint), actuators_of(model, joint)
        driving.update(found)
        if len(found) != 1:
            mend = f'give it one: <position joint="{name}" kp="…" kv="…"/>'
            yield Finding(f"{name} has {len(found) or 'no'} actuator{'s' * (len(found) > 1)}", mend)
        for actuator in found:
            gain, bias = model.actuator_gainprm[actuator], model.actuator_biasprm[actuator]
            fixed = model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
            affine = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
            if not (fixed and affine and gain[0] > 0 and bias[1] == -gain[0] and model.actuator_gear[actuator, 0] == 1):
                yield Finding(f"the actuator of {name} is no position actuator", "use <position> with kp, and gear 1")
            elif model.actuator_dyntype[actuator] != mujoco.mjtDyn.mjDYN_NONE:
                yield Finding(f"the actuator of {name} filters its input", "remove its timeconst: commands are smooth")
            elif bias[2] == 0 and model.dof_damping[model.jnt_dofadr[joint]] == 0:
                yield Finding(f"nothing damps {name}", 'give its actuator kv, or dampratio="1"', breaks=False)
    for actuator in set(range(model.nu)) - driving:
        mend = "remove it: the arm's commands are one angle for each joint"
        yield Finding(f"actuator {model.actuator(actuator).name or actuator} drives no joint of the chain", mend)


def _tip(model: mujoco.MjModel) -> Iterator[Finding]:
    tip = tip_of(model)
    if tip is None:
        yield Finding("there is no tip", 'put <site name="tip" pos="…"/> where the end effector is')
    elif not moves(model, tip[0]):
        yield Finding("the tip does not move with any joint", "put the site into the body of the last link")


def _markers(model: mujoco.MjModel) -> Iterator[Finding]:
    found = balls(model)
    if not found:
        mend = f'make spheres that cameras see: <geom name="{MARKER}red" type="sphere" size="0.1" rgba="1 0 0 1"/>'
        yield Finding("there are no markers", mend)
    if len(found) > MOST_MARKERS:
        yield Finding(f"there are {len(found)} markers", f"keep to {MOST_MARKERS}")
    hues: dict[str, float] = {}
    names: set[str] = set()
    for ball in found:
        geom = ball.kind is Kind.GEOM
        if not NAME.fullmatch(ball.name):
            yield Finding(f"{ball.label} is no name for a marker", "use letters, digits, '_', '-' and '.', at most 64")
        if ball.name in names:
            yield Finding(f"there are two markers {ball.name}", "give each a name of its own")
        names.add(ball.name)
        if (model.geom_type if geom else model.site_type)[ball.index] != _SPHERE:
            yield Finding(f"{ball.label} is no sphere", 'markers are type="sphere": from any side they look alike')
        if geom and (model.geom_contype[ball.index] or model.geom_conaffinity[ball.index]) and _contacts(model):
            mend = 'contype="0" conaffinity="0", or <flag contact="disable"/>'
            yield Finding(f"{ball.label} collides with what it touches", mend, breaks=False)
        color = color_of(model, ball)
        chroma = color - color.mean()
        if not np.linalg.norm(chroma) > LEAST_SATURATION * color.sum() or color.sum() <= 0:
            yield Finding(f"{ball.label} is grey, as cameras see it", _OWN_COLOR)
            continue
        hue = math.atan2((chroma[1] - chroma[2]) / math.sqrt(2), (2 * chroma[0] - chroma[1] - chroma[2]) / math.sqrt(6))
        for other, at in hues.items():
            apart = abs(math.remainder(hue - at, 2 * math.pi))
            if apart < LEAST_HUE_DISTANCE_RAD:
                least = math.degrees(LEAST_HUE_DISTANCE_RAD)
                text = f"{ball.label} and {other} differ by {math.degrees(apart):.0f}° of hue"
                yield Finding(text, f"choose colours at least {least:.0f}° apart, better 30°")
        hues[ball.label] = hue


def _seen(model: mujoco.MjModel) -> Iterator[Finding]:
    """Whether the markers tell all angles, and the tip."""
    tip, found = tip_of(model), balls(model)
    if not found or not model.njnt:
        return
    untold = [_joint_name(model, joint) for joint in _untold(model, found)]
    if untold:
        mend = "put markers on the links after it, off its axis: two on the last link, and one off their line"
        yield Finding(f"no marker tells the angle of {', '.join(untold)}", mend, breaks=False)
    if tip is not None and moves(model, tip[0]):
        places = Places(model)
        joint, place = places.attached(*tip)
        here = [places.attached(b.body, shape_of(model, b)[0])[1] for b in found if carrier(model, b.body) == joint]
        if not any(_in_line(a, b, place) for i, a in enumerate(here) for b in here[i + 1 :]):
            mend = "put two markers on one line with it, on its link: without them sight does not correct the tip"
            yield Finding("the tip is not on a line through two markers of its link", mend, breaks=False)


def _untold(model: mujoco.MjModel, found: list[Element]) -> list[int]:
    """Joints that move no marker in any way that the others don't, at a pose without symmetries."""
    data = mujoco.MjData(model)
    limits = np.where(model.jnt_limited[:, None].astype(bool), model.jnt_range, [-1.0, 1.0])
    data.qpos[:] = limits[:, 0] + (limits[:, 1] - limits[:, 0]) * np.random.default_rng(0).uniform(0.3, 0.7, model.njnt)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    rows = []
    for ball in found:
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, place_of(data, ball), ball.body)
        rows.append(jacobian)
    _, values, vectors = np.linalg.svd(np.vstack(rows))
    unseen = vectors[np.append(values, np.zeros(model.nv - len(values))) < 1e-6]
    return [joint for joint in range(model.njnt) if len(unseen) and np.abs(unseen[:, joint]).max() > 1e-3]


def _cameras(model: mujoco.MjModel) -> Iterator[Finding]:
    if model.ncam < 2:
        mend = 'put at least two beside the arm, named as on the bus: <camera name="1" pos="…" xyaxes="…" fovy="60"/>'
        yield Finding(f"there {'is one camera' if model.ncam else 'are no cameras'}", mend, breaks=model.ncam == 0)
    if model.ncam > MOST_CAMERAS:
        yield Finding(f"there are {model.ncam} cameras", f"keep to {MOST_CAMERAS}")
    for index in range(model.ncam):
        camera = model.camera(index)
        name = f"camera {camera.name or index}"
        if not NAME.fullmatch(camera.name):
            yield Finding(f"{name} has no name for a key", "use letters, digits, '_', '-' and '.', at most 64")
        if moves(model, int(model.cam_bodyid[index])) or model.body_mocapid[model.cam_bodyid[index]] >= 0:
            yield Finding(f"{name} moves", "put it into the worldbody: vision takes a camera's pose as fixed")
        if model.cam_mode[index] != mujoco.mjtCamLight.mjCAMLIGHT_FIXED:
            yield Finding(f"{name} turns after something", 'give it mode="fixed" and its direction by xyaxes')
        if model.cam_projection[index] != mujoco.mjtProjection.mjPROJ_PERSPECTIVE:
            yield Finding(f"{name} does not see in perspective", "remove its projection")
        if model.cam_sensorsize[index].any():
            yield Finding(
                f"{name} has a sensor size", "describe it by fovy: focal and principal are not carried on yet"
            )
        size = size_of(model, index)
        if size is not None and not all(LEAST_SIDE_PX <= side <= MOST_SIDE_PX for side in size):
            mend = f"both sides must be within {LEAST_SIDE_PX} to {MOST_SIDE_PX} pixels"
            yield Finding(f"the resolution of {name} is {size[0]} x {size[1]}", mend)


def _weight(model: mujoco.MjModel) -> Iterator[Finding]:
    if not model.opt.gravity.any():
        return
    falling = [
        model.body(body).name or str(body)
        for body in range(1, model.nbody)
        if moves(model, body) and model.body_mass[body] > 0 and model.body_gravcomp[body] != 1
    ]
    if falling:
        mend = 'give them gravcomp="1", or <option gravity="0 0 0"/>: position actuators alone leave a steady error'
        yield Finding(
            f"{', '.join(falling)} {'sags' if len(falling) == 1 else 'sag'} under gravity", mend, breaks=False
        )


def _contacts(model: mujoco.MjModel) -> bool:
    return not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT


def _in_line(a: np.ndarray, b: np.ndarray, point: np.ndarray) -> bool:
    along = b - a
    length = float(np.linalg.norm(along))
    return length > 1e-9 and float(np.linalg.norm(np.cross(along / length, point - a))) < 1e-3


def _joint_name(model: mujoco.MjModel, joint: int) -> str:
    return model.joint(joint).name or f"joint {joint + 1}"
