"""A camera's lens: the pinhole with plumb_bob distortion that CameraCalibration tells, and its derivatives.

Pixels by OpenCV's convention: integer values are pixel centres. Points in the optical frame: x right, y down,
z forward.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration

from armsight.calibration import PLUMB_BOB, checked_lens, optical_frame

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Lens:
    """Size in pixels, focal lengths, principal point and distortion of one camera."""

    width: int
    height: int
    focal: Array
    """fx, fy in pixels."""
    centre: Array
    """cx, cy in pixels."""
    distortion: Array
    """k1, k2, p1, p2, k3."""

    @property
    def matrix(self) -> Array:
        """3 x 3, K."""
        (fx, fy), (cx, cy) = self.focal, self.centre
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def lens_of(calibration: CameraCalibration, camera: str) -> Lens:
    """The lens that a message tells.

    Raises:
        ConfigError: it is of another model, or its numbers can't be a lens.
    """
    calibration = checked_lens(calibration, camera)
    distortion = np.zeros(5)
    distortion[: len(calibration.D)] = calibration.D
    focal, centre = np.array([calibration.K[0], calibration.K[4]]), np.array([calibration.K[2], calibration.K[5]])
    return Lens(calibration.width, calibration.height, focal, centre, distortion)


def message_of(lens: Lens, camera: str) -> CameraCalibration:
    """A lens as it goes over the bus."""
    (fx, fy), (cx, cy) = map(float, lens.focal), map(float, lens.centre)
    return CameraCalibration(
        frame_id=optical_frame(camera),
        width=lens.width,
        height=lens.height,
        distortion_model=PLUMB_BOB,
        D=list(map(float, lens.distortion)),
        K=[fx, 0, cx, 0, fy, cy, 0, 0, 1],
        R=[1, 0, 0, 0, 1, 0, 0, 0, 1],
        P=[fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0],
    )


def distort(flat: Array, distortion: Array) -> tuple[Array, Array]:
    r"""Where the lens puts directions, on the plane z = 1, and how that changes with them.

    :math:`x' = x(1 + k_1 r^2 + k_2 r^4 + k_3 r^6) + 2 p_1 x y + p_2 (r^2 + 2 x^2)`, and y alike.

    Args:
        flat: n x 2, x/z and y/z.
        distortion: k1, k2, p1, p2, k3.

    Returns:
        n x 2 distorted, and n x 2 x 2 derivatives.
    """
    k1, k2, p1, p2, k3 = distortion
    x, y = flat[..., 0], flat[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))  # of `radial`, per x along x
    bent = np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )
    cross = x * y * slope + 2 * p1 * x + 2 * p2 * y
    change = np.empty((*x.shape, 2, 2))
    change[..., 0, 0] = radial + x * x * slope + 2 * p1 * y + 6 * p2 * x
    change[..., 0, 1] = change[..., 1, 0] = cross
    change[..., 1, 1] = radial + y * y * slope + 6 * p1 * y + 2 * p2 * x
    return bent, change


def project(lens: Lens, points: Array) -> tuple[Array, Array]:
    """Pixels of points, and how these change with the points.

    Args:
        lens: the camera's.
        points: n x 3 in the optical frame, in front of the camera.

    Returns:
        n x 2 pixels, and n x 2 x 3 derivatives in pixels per metre.
    """
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    bent, change = distort(np.stack([x / z, y / z], axis=-1), lens.distortion)
    flat = np.zeros((*x.shape, 2, 3))
    flat[..., 0, 0] = flat[..., 1, 1] = 1 / z
    flat[..., 0, 2], flat[..., 1, 2] = -x / z**2, -y / z**2
    return bent * lens.focal + lens.centre, (change @ flat) * lens.focal[:, None]


def reaches(lens: Lens) -> bool:
    """Whether the radial distortion still grows at the picture's corners; where it folds, pixels have no direction."""
    corners = np.array([[x, y] for x in (0.0, lens.width - 1.0) for y in (0.0, lens.height - 1.0)])
    farthest = float(np.linalg.norm((corners - lens.centre) / lens.focal, axis=1).max())
    k1, k2, _, _, k3 = lens.distortion
    radius = np.linspace(0.0, 3.0 * farthest, 600)
    bent = radius * (1 + k1 * radius**2 + k2 * radius**4 + k3 * radius**6)
    falls = np.flatnonzero(np.diff(bent) <= 0)
    return bool((bent[falls[0]] if falls.size else bent[-1]) >= farthest)
