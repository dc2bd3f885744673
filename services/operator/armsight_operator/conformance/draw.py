"""Frames of coloured spheres over grey, drawn ray by ray: what a vision is shown, and exactly where everything is."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from armsight.calibration import optical_frame
from armsight.times import to_timestamp
from armsight_operator import rotations
from armsight_operator.conformance.scene import Ball

Array = npt.NDArray[np.float64]
Pixels = npt.NDArray[np.uint8]

_BACKGROUND = 0.7
_AMBIENT, _DIFFUSE = 0.45, 0.5
_TO_LIGHT = np.array([0.5, -0.5, 0.8]) / math.sqrt(1.14)
"""World frame."""
_SAMPLES = 3
"""In each direction of a pixel: outlines are told to a tenth of a pixel."""


@dataclass(frozen=True, slots=True)
class Camera:
    """An ideal pinhole camera, in OpenCV's convention: x right, y down, z into the scene."""

    name: str
    position: Array
    """World frame, metres."""
    look_at: Array
    """World frame, metres."""
    width: int
    height: int
    fovy_rad: float

    @property
    def focal_px(self) -> float:
        """Of both axes."""
        return self.height / 2 / math.tan(self.fovy_rad / 2)

    @property
    def centre_px(self) -> Array:
        """The middle of the picture: column and row."""
        return np.array([self.width - 1, self.height - 1]) / 2

    def in_optical_frame(self, point: Array) -> Array:
        """A point of the world as the camera has it, metres."""
        return np.asarray(self.rotation.T @ (point - self.position))

    def pixel(self, optical: Array) -> Array:
        """Where a point of the optical frame is in the picture: column and row."""
        return np.asarray(self.focal_px * optical[:2] / optical[2] + self.centre_px)

    @property
    def rotation(self) -> Array:
        """Turns optical axes into the world: columns are right, down, forward."""
        forward = self.look_at - self.position
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        right = right / np.linalg.norm(right)
        return np.stack([right, np.cross(forward, right), forward], axis=1)

    @property
    def frame_id(self) -> str:
        """Of the optical frame."""
        return optical_frame(self.name)

    def calibration(self, stamp_ns: int) -> CameraCalibration:
        """As sim would publish it."""
        f, (cx, cy) = self.focal_px, self.centre_px.tolist()
        return CameraCalibration(
            timestamp=to_timestamp(stamp_ns),
            frame_id=self.frame_id,
            width=self.width,
            height=self.height,
            distortion_model="plumb_bob",
            D=[0.0] * 5,
            K=[f, 0, cx, 0, f, cy, 0, 0, 1],
            R=[1, 0, 0, 0, 1, 0, 0, 0, 1],
            P=[f, 0, cx, 0, 0, f, cy, 0, 0, 0, 1, 0],
        )

    def pose(self, stamp_ns: int) -> FrameTransform:
        """T_world_optical."""
        message = FrameTransform(
            timestamp=to_timestamp(stamp_ns), parent_frame_id="world", child_frame_id=self.frame_id
        )
        message.translation.x, message.translation.y, message.translation.z = self.position
        w, x, y, z = rotations.of_matrix(self.rotation.tolist())
        message.rotation.w, message.rotation.x, message.rotation.y, message.rotation.z = w, x, y, z
        return message

    def draw(self, balls: Sequence[Ball]) -> Pixels:
        """Height x width x 3; the nearest sphere is in front, edges are shares of what a pixel covers."""
        image = np.full((self.height, self.width, 3), _BACKGROUND)
        # the farthest first: outlines are mixed with what is behind them
        for ball in sorted(balls, key=lambda ball: -float(np.linalg.norm(ball.centre - self.position))):
            self._draw_one(image, ball)
        return np.asarray(np.clip(image * 255 + 0.5, 0, 255), dtype=np.uint8)

    def _draw_one(self, image: Array, ball: Ball) -> None:
        centre = self.in_optical_frame(ball.centre)
        if centre[2] <= ball.radius_m:
            return
        f, (cx, cy), (u, v) = self.focal_px, self.centre_px, self.pixel(centre)
        reach = 1.5 * f * ball.radius_m / (centre[2] - ball.radius_m) + 2
        left, right = max(0, int(u - reach)), min(self.width, int(u + reach) + 1)
        top, bottom = max(0, int(v - reach)), min(self.height, int(v + reach) + 1)
        if left >= right or top >= bottom:
            return
        inside = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
        columns = (np.arange(left, right)[:, None] + inside).ravel()
        rows = (np.arange(top, bottom)[:, None] + inside).ravel()
        rays = np.stack(np.broadcast_arrays((columns[None] - cx) / f, (rows[:, None] - cy) / f, 1.0), axis=-1)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        # |t d - c| = r: t = d·c - sqrt((d·c)² - c·c + r²)
        along = rays @ centre
        inner = along**2 - centre @ centre + ball.radius_m**2
        hit = inner > 0
        depth = along - np.sqrt(np.where(hit, inner, 0.0))
        normals = (rays * depth[..., None] - centre) / ball.radius_m
        light = _AMBIENT + _DIFFUSE * np.clip(normals @ (self.rotation.T @ _TO_LIGHT), 0.0, 1.0)
        shaded = light[..., None] * np.array(ball.color)
        tile = image[top:bottom, left:right]
        height, width = bottom - top, right - left

        def mean(samples: Array) -> Array:
            return np.asarray(samples.reshape(height, _SAMPLES, width, _SAMPLES, -1).mean(axis=(1, 3)))

        share = mean(hit[..., None].astype(np.float64))
        tile[:] = (1 - share) * tile + mean(np.where(hit[..., None], shaded, 0.0))
