r"""Forward kinematics and Jacobians: of any serial chain, and the report's closed forms.

Frames: ``base`` is the first joint's frame at angle 0, z up. ``R_a_b`` turns vectors of frame b into frame a.
The report's symbols are spelt theta, nu, phi, psi for joints 1 to 4; s and c before one are its sine and cosine.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from armsight_control.chain import Array, Chain, Point, Triple
from armsight_control.errors import JointCountError, UnsupportedArmError

_SHAPE_TOLERANCE = 1e-6


# --- any serial chain


def frames(chain: Chain, q: Array) -> tuple[Array, Array]:
    r"""Rotation and origin of the base and of every joint's frame, in the base frame.

    Product of the joints' transforms, :math:`T_{base,i} = T_{base,i-1}\, \mathrm{Trans}(o_i)\, \mathrm{Rot}(a_i, q_i)`.

    Args:
        chain: the arm.
        q: joint angles in radians; leading dimensions are a batch. Limits are not checked here.

    Returns:
        Rotations (..., n + 1, 3, 3) and origins (..., n + 1, 3); index 0 is the base, index i + 1 joint i.

    Raises:
        JointCountError: the last dimension is not the number of joints.
    """
    q = _checked(chain, q)
    if q.ndim == 1:
        listed = _frames_of_one(chain, q.tolist())
        return np.array([r for r, _ in listed]).reshape(-1, 3, 3), np.array([o for _, o in listed])
    batch = q.shape[:-1]
    rotations = np.empty((*batch, chain.count + 1, 3, 3))
    origins = np.empty((*batch, chain.count + 1, 3))
    rotations[..., 0, :, :], origins[..., 0, :] = np.eye(3), 0.0
    for i in range(chain.count):
        origins[..., i + 1, :] = origins[..., i, :] + rotations[..., i, :, :] @ chain.origins[i]
        rotations[..., i + 1, :, :] = rotations[..., i, :, :] @ _turn(chain.axes[i], q[..., i])
    return rotations, origins


def position(chain: Chain, q: Array, point: Point) -> Array:
    """A point of the arm in the base frame, in metres; arguments as :func:`frames`."""
    q = _checked(chain, q)
    if q.ndim == 1:
        return np.array(_position_of_one(chain, q.tolist(), point))
    rotations, origins = frames(chain, q)
    return np.asarray(origins[..., point.joint + 1, :] + rotations[..., point.joint + 1, :, :] @ point.position)


def jacobian(chain: Chain, q: Array, point: Point | None = None) -> Array:
    r"""Derivative of a point (default: the tip) by the angles, (..., 3, n), metres per radian.

    Column i is :math:`z_i \times (p - o_i)` for the joints that carry the point, zero for those after it.
    """
    point = chain.tip if point is None else point
    q = _checked(chain, q)
    if q.ndim == 1:
        ((_, of_one),) = points_and_columns(chain, q, [point])
        return np.array(of_one).T
    rotations, origins = frames(chain, q)
    p = origins[..., point.joint + 1, :] + rotations[..., point.joint + 1, :, :] @ point.position
    columns = np.zeros((*p.shape, chain.count))
    for i in range(point.joint + 1):
        # the axis is the same in the joint's own frame before and after it turned
        axis = rotations[..., i + 1, :, :] @ chain.axes[i]
        columns[..., i] = np.cross(axis, p - origins[..., i + 1, :])
    return columns


def forward(chain: Chain, q: Array) -> Array:
    """The tip in the base frame, in metres: for this arm the report's section 4.1 with all four joints free."""
    return position(chain, q, chain.tip)


# One configuration in plain floats: numpy's calls on arrays of three cost ten times what they compute.
_Frame = tuple[tuple[float, ...], Triple]
_BASE: _Frame = ((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0))


def points_and_columns(
    chain: Chain, q: Array | Sequence[float], points: Sequence[Point]
) -> Iterator[tuple[Triple, list[Triple]]]:
    """Points of one configuration with the columns of their Jacobians, in plain floats: metres, and metres per radian.

    Raises:
        JointCountError: not so many angles as joints.
    """
    found = _frames_of_one(chain, _checked(chain, q).tolist())
    axes = _axes_of_one(chain, found)
    return (_columns_of_one(chain, found, axes, point) for point in points)


def _checked(chain: Chain, q: Array | Sequence[float]) -> Array:
    q = np.asarray(q, dtype=np.float64)
    if q.shape[-1:] != (chain.count,):
        raise JointCountError(f"{q.shape[-1] if q.ndim else 0} angles for an arm of {chain.count} joints")
    return q


def _position_of_one(chain: Chain, q: Sequence[float], point: Point) -> Triple:
    r"""A point in the base frame, taken from joint to joint towards the base.

    Rodrigues' formula: :math:`p' = o + c\, p + s\, a \times p + (1 - c)(a \cdot p)\, a` for each joint at o about a.
    """
    x, y, z = point.position.tolist()
    for i in range(point.joint, -1, -1):
        (u, v, w), (k, l, m) = chain.joints[i]  # noqa: E741
        sine, cosine = math.sin(q[i]), math.cos(q[i])
        along = (1.0 - cosine) * (k * x + l * y + m * z)
        x, y, z = (
            u + cosine * x + sine * (l * z - m * y) + along * k,
            v + cosine * y + sine * (m * x - k * z) + along * l,
            w + cosine * z + sine * (k * y - l * x) + along * m,
        )
    return x, y, z


def _frames_of_one(chain: Chain, q: Sequence[float]) -> list[_Frame]:
    """Rotation, row by row, and origin of the base and of every joint's frame."""
    found = [_BASE]
    (a, b, c, d, e, f, g, h, i), (u, v, w) = _BASE
    for ((x, y, z), (k, l, m)), angle in zip(chain.joints, q, strict=True):  # noqa: E741  (k, l, m) is the axis
        u, v, w = u + a * x + b * y + c * z, v + d * x + e * y + f * z, w + g * x + h * y + i * z
        sine, cosine = math.sin(angle), math.cos(angle)
        t = 1.0 - cosine
        kt, lt, mt, ks, ls, ms = k * t, l * t, m * t, k * sine, l * sine, m * sine
        r, s, n = kt * k + cosine, kt * l - ms, kt * m + ls
        o, p, j = lt * k + ms, lt * l + cosine, lt * m - ks
        x, y, z = mt * k - ls, mt * l + ks, mt * m + cosine
        a, b, c = a * r + b * o + c * x, a * s + b * p + c * y, a * n + b * j + c * z
        d, e, f = d * r + e * o + f * x, d * s + e * p + f * y, d * n + e * j + f * z
        g, h, i = g * r + h * o + i * x, g * s + h * p + i * y, g * n + h * j + i * z
        found.append(((a, b, c, d, e, f, g, h, i), (u, v, w)))
    return found


def _carried(frame: _Frame, point: Point) -> Triple:
    (a, b, c, d, e, f, g, h, i), (u, v, w) = frame
    x, y, z = point.position.tolist()
    return u + a * x + b * y + c * z, v + d * x + e * y + f * z, w + g * x + h * y + i * z


def _columns_of_one(chain: Chain, found: list[_Frame], axes: list[Triple], point: Point) -> tuple[Triple, list[Triple]]:
    """A point, and how it moves with every joint: the columns of its Jacobian."""
    x, y, z = place = _carried(found[point.joint + 1], point)
    columns = [(0.0, 0.0, 0.0)] * chain.count
    for n, (k, l, m) in enumerate(axes[: point.joint + 1]):  # noqa: E741
        _, (u, v, w) = found[n + 1]
        u, v, w = x - u, y - v, z - w
        columns[n] = (l * w - m * v, m * u - k * w, k * v - l * u)
    return place, columns


def _axes_of_one(chain: Chain, found: list[_Frame]) -> list[Triple]:
    """Of every joint, in the base frame."""
    turned = []
    for (_, (k, l, m)), ((a, b, c, d, e, f, g, h, i), _) in zip(chain.joints, found[1:], strict=True):  # noqa: E741
        turned.append((a * k + b * l + c * m, d * k + e * l + f * m, g * k + h * l + i * m))
    return turned


def _turn(axis: Array, angle: Array) -> Array:
    """Rodrigues' formula: the rotation by ``angle`` about a unit vector."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    return np.asarray(np.eye(3) + s * cross + (1 - c) * (cross @ cross))


# --- the report's arm


@dataclass(frozen=True, slots=True)
class Links:
    """Lengths of the report's arm in metres; L2 is 0, joints 2 and 3 coincide."""

    l1: float
    """From joint 1's frame to the shoulder (joints 2 and 3)."""
    l3: float
    """From the shoulder to joint 4."""
    l4: float
    """From joint 4 to the tip."""


@lru_cache(maxsize=16)
def links_of(chain: Chain) -> Links:
    """The lengths of a chain of the report's shape.

    Raises:
        UnsupportedArmError: other axes, offsets or limits than the report's; its formulas don't apply.
    """
    expected = np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float64)
    if chain.axes.shape != expected.shape or np.abs(chain.axes - expected).max() > _SHAPE_TOLERANCE:
        raise UnsupportedArmError("the report's formulas need four joints about z, y, x and y")
    tip_on_joint4 = chain.tip.joint == chain.count - 1
    along_z = np.abs(np.vstack([chain.origins[:, :2], chain.tip.position[:2]])).max() <= _SHAPE_TOLERANCE
    lengths = [chain.origins[0, 2] + chain.origins[1, 2], chain.origins[3, 2], chain.tip.position[2]]
    if not tip_on_joint4 or not along_z or abs(chain.origins[2, 2]) > _SHAPE_TOLERANCE or min(lengths) <= 0:
        raise UnsupportedArmError("the report's formulas need links along z, joints 2 and 3 in one place")
    bounds = np.array([math.pi, math.pi / 2, math.pi / 2, math.pi / 2])
    if np.abs(chain.limits - np.stack([-bounds, bounds], axis=1)).max() > 1e-3:
        raise UnsupportedArmError("the report's formulas need limits of ±π for joint 1 and ±π/2 for the others")
    return Links(*map(float, lengths))


@lru_cache(maxsize=16)
def links_of_report(chain: Chain) -> Links | None:
    """The lengths of a chain of the report's shape; nothing for another."""
    try:
        return links_of(chain)
    except UnsupportedArmError:
        return None


def need_report(chain: Chain, what: str, instead: str) -> Links:
    """The lengths of a chain of the report's shape, for what is for that arm alone.

    Raises:
        UnsupportedArmError: it is another arm; says what does not apply, why, and what to use instead.
    """
    try:
        return links_of(chain)
    except UnsupportedArmError as error:
        raise UnsupportedArmError(f"{what} does not apply to this arm: {error}; use {instead}") from None


def report_forward(links: Links, q: Array) -> Array:
    r"""The report's K(q), section 4.1: the tip with joint 2 at 0.

    .. math:: K = (c_\vartheta s_\psi L_4 + s_\vartheta s_\phi c_\psi L_4 + s_\vartheta s_\phi L_3,\;
        s_\vartheta s_\psi L_4 - c_\vartheta s_\phi c_\psi L_4 - c_\vartheta s_\phi L_3,\;
        c_\phi c_\psi L_4 + c_\phi L_3 + L_1)

    Args:
        links: the lengths.
        q: (..., 3) theta, phi, psi in radians.
    """
    (s_theta, s_phi, s_psi), (c_theta, c_phi, c_psi) = _sines(q)
    l4_s, reach = links.l4 * s_psi, links.l4 * c_psi + links.l3
    return np.stack(
        [
            c_theta * l4_s + s_theta * s_phi * reach,
            s_theta * l4_s - c_theta * s_phi * reach,
            c_phi * reach + links.l1,
        ],
        axis=-1,
    )


def report_jacobian(links: Links, q: Array) -> Array:
    """The report's J(q), section 4.2: dK/d(theta, phi, psi), (..., 3, 3); arguments as :func:`report_forward`."""
    (s_theta, s_phi, s_psi), (c_theta, c_phi, c_psi) = _sines(q)
    l4_s, l4_c = links.l4 * s_psi, links.l4 * c_psi
    reach = l4_c + links.l3
    zero = np.zeros_like(l4_s)
    rows = [
        [
            -s_theta * l4_s + c_theta * s_phi * reach,
            s_theta * c_phi * reach,
            c_theta * l4_c - s_theta * s_phi * l4_s,
        ],
        [
            c_theta * l4_s + s_theta * s_phi * reach,
            -c_theta * c_phi * reach,
            s_theta * l4_c + c_theta * s_phi * l4_s,
        ],
        [zero, -s_phi * reach, -c_phi * l4_s],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def directions(q: Array) -> tuple[Array, Array]:
    r"""The report's unit vectors along links 3 and 4 of its arm, section 3, from all four angles.

    :math:`r_3 = R e_z`, :math:`r_4 = R R_y(\psi) e_z` with :math:`R = R_z(\vartheta) R_y(\nu) R_x(\phi)`.
    """
    q = np.asarray(q, dtype=np.float64)
    s_theta, s_nu, s_phi, s_psi = np.moveaxis(np.sin(q), -1, 0)
    c_theta, c_nu, c_phi, c_psi = np.moveaxis(np.cos(q), -1, 0)
    r3 = [c_theta * s_nu * c_phi + s_theta * s_phi, s_theta * s_nu * c_phi - c_theta * s_phi, c_nu * c_phi]
    wrist_x = [c_theta * c_nu, s_theta * c_nu, -s_nu]
    r4 = [c_psi * along + s_psi * across for along, across in zip(r3, wrist_x, strict=True)]
    return np.stack(r3, axis=-1), np.stack(r4, axis=-1)


@dataclass(frozen=True, slots=True)
class DhRow:
    """One row of a Denavit-Hartenberg table: Rot_z(theta) Trans_z(d) Trans_x(a) Rot_x(alpha)."""

    theta: float
    """Added to the joint's angle, rad."""
    d: float
    a: float
    alpha: float


def denavit_hartenberg(links: Links) -> tuple[DhRow, ...]:
    """The arm's table, joints 1 to 4; the last frame sits at the tip (docs/denavit-hartenberg.md derives it)."""
    quarter = math.pi / 2
    return (
        DhRow(theta=0.0, d=links.l1, a=0.0, alpha=-quarter),
        DhRow(theta=-quarter, d=0.0, a=0.0, alpha=-quarter),
        DhRow(theta=0.0, d=0.0, a=links.l3, alpha=quarter),
        DhRow(theta=0.0, d=0.0, a=links.l4, alpha=0.0),
    )


def denavit_hartenberg_product(rows: tuple[DhRow, ...], q: Array) -> Array:
    """T_base_tip, 4 x 4: the product of the table's transforms at the angles ``q``."""
    product = np.eye(4)
    for row, angle in zip(rows, q, strict=True):
        s, c = math.sin(angle + row.theta), math.cos(angle + row.theta)
        s_alpha, c_alpha = math.sin(row.alpha), math.cos(row.alpha)
        product = product @ np.array(
            [
                [c, -s * c_alpha, s * s_alpha, row.a * c],
                [s, c * c_alpha, -c * s_alpha, row.a * s],
                [0.0, s_alpha, c_alpha, row.d],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
    return product


def _sines(q: Array) -> tuple[Array, Array]:
    q = np.asarray(q, dtype=np.float64)
    return np.moveaxis(np.sin(q), -1, 0), np.moveaxis(np.cos(q), -1, 0)
