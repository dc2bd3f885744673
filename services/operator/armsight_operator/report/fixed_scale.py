"""The report's own way of measuring, on the same frames: the peer that the table shows beside ours.

Masks by chromaticity, their centroids, and one pixel-to-metre constant for every distance: camera 1 gives y, camera 2
gives x, and z is taken from one of them (the report, chapter 3). No marker offsets, no calibration.
"""

import numpy as np

from armsight_operator.report.chain import Array

_MIN_CHROMA = 0.5
_MIN_SUM = 30.0
_BASE_HEIGHT_M = 0.5


def metres_per_pixel(distance_m: float, focal_px: float) -> float:
    """The constant: right at the distance of the base's axis, and used everywhere."""
    return distance_m / focal_px


def red_centroid(image: Array) -> Array:
    """Centroid (u, v) of the end effector's mask, in pixels from the image's corner.

    Raises:
        ValueError: nothing red in the image.
    """
    total = image.sum(axis=2)
    share = image / np.maximum(total, 1.0)[..., None]
    mask = (share[..., 0] > _MIN_CHROMA) & (share[..., 1] < 0.25) & (share[..., 2] < 0.25) & (total > _MIN_SUM)
    rows, columns = np.nonzero(mask)
    if rows.size == 0:
        raise ValueError("nothing red in the image")
    return np.array([columns.mean() + 0.5, rows.mean() + 0.5])


def end_effector(front: Array, side: Array, scale: float, camera_height_m: float) -> Array:
    """The end effector in the base frame, metres.

    Args:
        front: image of camera 1, which looks along -x: right is +y.
        side: image of camera 2, which looks along +y: right is +x.
        scale: metres for a pixel.
        camera_height_m: of both cameras above the ground.
    """
    height, width = front.shape[:2]
    centre = np.array([width / 2, height / 2])
    y, down = (red_centroid(front) - centre) * scale
    x, _ = (red_centroid(side) - centre) * scale
    return np.array([x, y, camera_height_m - down - _BASE_HEIGHT_M])
