"""What of a MuJoCo model is the arm: its chain, its markers, what is drawn of it, and where all of that is.

The frame of a joint is parallel to the base frame at angle 0, whatever its body's own: bodies may be turned, joints lie
beside their bodies' origins, and bodies without joints stand between. Where none of that is so, every number is the
model's own, to the bit.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

import mujoco
import numpy as np
import numpy.typing as npt

Vector = npt.NDArray[np.float64]

MARKER, LINK = "marker_", "link_"
BASE, TIP = "base", "tip"
_LAST_DRAWN_GROUP = 2
"""MuJoCo draws the groups 0 to 2 unless it is told otherwise."""


class Kind(Enum):
    """What an element of the model is."""

    GEOM = "geom"
    SITE = "site"


@dataclass(frozen=True, slots=True)
class Element:
    """A geom or site of the model."""

    kind: Kind
    index: int
    name: str
    """Without the prefix of its convention."""
    label: str
    """As the model calls it."""
    body: int


def balls(model: mujoco.MjModel) -> list[Element]:
    """What is named as a marker: geoms and sites `marker_NAME`, or the only geom of a body of that name (of a URDF)."""
    found = []
    for element in _elements(model):
        if element.label.startswith(MARKER):
            found.append(_named(element, element.label.removeprefix(MARKER)))
        elif element.kind is Kind.GEOM and not element.label:
            body = model.body(element.body)
            if body.name.startswith(MARKER) and model.body_geomnum[element.body] == 1:
                found.append(Element(Kind.GEOM, element.index, body.name.removeprefix(MARKER), body.name, element.body))
    return found


def drawn_links(model: mujoco.MjModel) -> list[Element]:
    """Geoms `base` and `link_NAME`; of a model that has none, everything that is drawn of the arm but its markers."""
    geoms = [element for element in _elements(model) if element.kind is Kind.GEOM]
    named = [_named(e, e.label.removeprefix(LINK)) for e in geoms if e.label == BASE or e.label.startswith(LINK)]
    if named:
        return named
    markers = {ball.index for ball in balls(model) if ball.kind is Kind.GEOM}
    first = int(model.jnt_bodyid[0]) if model.njnt else -1
    return [
        _named(element, element.label or f"{model.body(element.body).name}_{element.index}")
        for element in geoms
        if element.index not in markers
        and (moves(model, element.body) or element.body in _above(model, first))
        and model.geom_group[element.index] <= _LAST_DRAWN_GROUP
    ]


def tip_of(model: mujoco.MjModel) -> tuple[int, Vector] | None:
    """Body and place in it of the site `tip`, or of the body of that name (of a URDF); nothing without either."""
    for index in range(model.nsite):
        if model.site(index).name == TIP:
            return int(model.site_bodyid[index]), model.site_pos[index].copy()
    for index in range(1, model.nbody):
        if model.body(index).name == TIP:
            return index, np.zeros(3)
    return None


def shape_of(model: mujoco.MjModel, element: Element) -> tuple[Vector, Vector]:
    """Place in its body, and size, of a geom or site."""
    if element.kind is Kind.GEOM:
        return model.geom_pos[element.index], model.geom_size[element.index]
    return model.site_pos[element.index], model.site_size[element.index]


def place_of(data: mujoco.MjData, element: Element) -> Vector:
    """Where a geom or site is now, world frame."""
    return np.asarray((data.geom_xpos if element.kind is Kind.GEOM else data.site_xpos)[element.index])


def carrier(model: mujoco.MjModel, body: int) -> int:
    """The joint that a body moves with: its own, or that of the next body below it; -1 where none moves it."""
    while body != 0 and model.body_jntnum[body] == 0:
        body = int(model.body_parentid[body])
    return int(model.body_jntadr[body]) if body != 0 else -1


def moves(model: mujoco.MjModel, body: int) -> bool:
    """Whether a joint moves a body."""
    return carrier(model, body) >= 0


class Places:
    """Where everything is in the frames of the description.

    Args:
        model: its joints are hinges, one after the other; :mod:`armsight_sim.conventions` says whether they are.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        """Walks along the chain once."""
        self._model = model
        self._bodies = [int(model.jnt_bodyid[index]) for index in range(model.njnt)]
        first = self._bodies[0]
        position, self.R_world_base = _within(model, first, 0)
        self.p_world_base: Vector = position + self.R_world_base @ model.jnt_pos[0]
        self._R_base_body = [np.eye(3)]
        self.origins: list[Vector] = [np.zeros(3)]
        """Of every joint in its parent's frame; the first one's is the base frame's own."""
        for index, body in enumerate(self._bodies[1:], start=1):
            position, rotation = _within(model, body, self._bodies[index - 1])
            before = self._R_base_body[-1]
            self.origins.append(before @ (position + rotation @ model.jnt_pos[index] - model.jnt_pos[index - 1]))
            self._R_base_body.append(before @ rotation)
        self.axes: list[Vector] = [R @ model.jnt_axis[i] for i, R in enumerate(self._R_base_body)]
        """Of every joint in its own frame, unit vectors."""

    def attached(self, body: int, position: Vector) -> tuple[int, Vector]:
        """A point of a body: the joint that carries it, or -1, and its place in that joint's frame or the base's."""
        joint = carrier(self._model, body)
        within, rotation = _within(self._model, body, self._bodies[joint] if joint >= 0 else 0)
        point = within + rotation @ position
        if joint < 0:
            return joint, np.asarray(self.R_world_base.T @ (point - self.p_world_base))
        return joint, np.asarray(self._R_base_body[joint] @ (point - self._model.jnt_pos[joint]))


def pose_in_world(model: mujoco.MjModel, body: int) -> tuple[Vector, Vector]:
    """Position and rotation (3 x 3) of a body that nothing moves, in the world frame."""
    return _within(model, body, 0)


def rotation_of(quaternion: Vector) -> Vector:
    """The 3 x 3 matrix of a unit quaternion w, x, y, z."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _within(model: mujoco.MjModel, body: int, ancestor: int) -> tuple[Vector, Vector]:
    """Position and rotation of a body's frame, with all joints at 0, in the frame of one that it is below."""
    position, rotation = np.zeros(3), np.eye(3)
    while body not in (ancestor, 0):
        turned = rotation_of(model.body_quat[body])
        position, rotation = model.body_pos[body] + turned @ position, turned @ rotation
        body = int(model.body_parentid[body])
    return position, rotation


def _above(model: mujoco.MjModel, body: int) -> list[int]:
    """The bodies that a body stands on, without the world."""
    found = []
    while body > 0:
        body = int(model.body_parentid[body])
        if body > 0:
            found.append(body)
    return found


def _elements(model: mujoco.MjModel) -> Iterator[Element]:
    for index in range(model.ngeom):
        label = model.geom(index).name
        yield Element(Kind.GEOM, index, label, label, int(model.geom_bodyid[index]))
    for index in range(model.nsite):
        label = model.site(index).name
        yield Element(Kind.SITE, index, label, label, int(model.site_bodyid[index]))


def _named(element: Element, name: str) -> Element:
    return Element(element.kind, element.index, name, element.label, element.body)
