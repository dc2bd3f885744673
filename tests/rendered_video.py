"""Pictures as a real camera would take them: a lens with distortion, noise, and a camera that is not where it is said.

Nothing here shares code with what calibrates: distortion is inverted by Newton's method, boards are drawn by casting a
ray for each part of a pixel, the arm is rendered with a wide field of view and bent afterwards.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import mujoco
import numpy as np
import numpy.typing as npt

from armsight_sim.cameras import Cameras, Commission
from armsight_sim.world import load_model

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

SIDE = 800
PARTS = 2
"""Samples along each side of a pixel, averaged."""
NOISE = 2.0
"""Grey levels."""
_FINE = 2.2
"""Pixels of the wide rendering for one of the picture, at the middle."""


@dataclass(frozen=True)
class TrueLens:
    """What calibration has to find; pixels by OpenCV's convention."""

    focal: float
    centre: tuple[float, float]
    k1: float
    k2: float
    p1: float = 0.0
    p2: float = 0.0

    def bend(self, x: Array, y: Array) -> tuple[Array, Array]:
        r2 = x * x + y * y
        radial = 1 + self.k1 * r2 + self.k2 * r2 * r2
        return (
            x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x),
            y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y,
        )

    def directions(self) -> tuple[Array, Array]:
        """x/z and y/z of every part of every pixel: two arrays of SIDE * PARTS squared, not to be written to."""
        return _directions(self)


LENSES = {
    "1": TrueLens(476.0, (402.3, 396.8), -0.20, 0.05, 0.0006, -0.0004),
    "2": TrueLens(482.0, (396.1, 403.4), -0.18, 0.04, -0.0005, 0.0007),
}


class ArmFilm:
    """Both cameras' pictures of the arm; camera 2 stands and looks elsewhere than its description says."""

    def __init__(self, seed: int, turn_deg: float = 3.0, shift_m: float = 0.3) -> None:
        random = np.random.default_rng([seed, 7])
        model = load_model()
        self.described = load_model()
        camera = model.camera("2")
        turn = np.zeros(4)
        mujoco.mju_axisAngle2Quat(turn, _unit(random), np.radians(turn_deg))
        turned = np.zeros(4)
        mujoco.mju_mulQuat(turned, turn, np.array(camera.quat))
        model.cam_quat[camera.id] = turned
        model.cam_pos[camera.id] += shift_m * _unit(random)
        self.data, self.model = mujoco.MjData(model), model
        self._noise = np.random.default_rng([seed, 8])
        self._maps: dict[str, tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]] = {}
        side = 0
        for name, lens in LENSES.items():
            x, y = lens.directions()
            reach = 1.01 * max(np.abs(x).max(), np.abs(y).max())
            side = max(side, int(2 * reach * lens.focal * _FINE) + 2)
            model.cam_fovy[model.camera(name).id] = np.degrees(2 * np.arctan(reach))
            self._maps[name] = (x / reach).astype(np.float32), (y / reach).astype(np.float32)
        # pixel (i, j) covers [i, i + 1]: its middle is at + 0.5
        half = np.float32(side / 2)
        for name, (across, down) in self._maps.items():
            self._maps[name] = (across + 1) * half - np.float32(0.5), (down + 1) * half - np.float32(0.5)
        self._cameras = Cameras(Commission(model, tuple(LENSES), side, side, 4))

    def take(self, q: Sequence[float]) -> dict[str, Picture]:
        """One picture for each camera at a pose."""
        self.data.qpos[:] = q
        mujoco.mj_forward(self.model, self.data)
        pictures = {}
        for name, wide in zip(LENSES, self._cameras.draw(self.data), strict=True):
            parts = cv2.remap(wide, *self._maps[name], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            pictures[name] = noisy(_averaged(np.asarray(parts, dtype=np.uint8)), self._noise)
        return pictures

    def markers(self) -> dict[str, Array]:
        """True centres in the world at the last pose."""
        names = [self.model.geom(i).name for i in range(self.model.ngeom)]
        return {
            name.removeprefix("marker_"): np.array(self.data.geom_xpos[i])
            for i, name in enumerate(names)
            if name.startswith("marker_")
        }

    def close(self) -> None:
        self._cameras.close()


def poses(seed: int, count: int) -> Array:
    """Random ones, not so near to the limits that links hide everything."""
    random = np.random.default_rng([seed, 9])
    return np.asarray(random.uniform((-3.0, -1.1, -1.1, -1.2), (3.0, 1.1, 1.1, 1.2), (count, 4)))


def board_film(lens: TrueLens, texture: Picture, size_m: Array, seed: int, count: int) -> Iterator[Picture]:
    """A board held at many places and angles.

    Args:
        lens: the camera's.
        texture: what is printed, grey, with its margin.
        size_m: width and height of all of that.
        seed: of places and noise.
        count: of pictures.
    """
    random = np.random.default_rng([seed, 10])
    x, y = lens.directions()
    spots = [(u, v) for u in (-0.75, 0.0, 0.75) for v in (-0.75, 0.0, 0.75)]
    for number in range(count):
        u, v = spots[number % len(spots)]
        depth = size_m.max() * random.uniform(0.9, 1.5)
        tilt = random.uniform(-0.6, 0.6, 2)
        turn = np.array([tilt[0], tilt[1], random.uniform(-0.4, 0.4)])
        rotation = np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64)
        middle = np.array([u * 0.8, v * 0.8, 1.0]) * depth
        yield draw_board(x, y, texture, size_m, rotation, middle, random)


def draw_board(
    x: Array, y: Array, texture: Picture, size_m: Array, rotation: Array, middle: Array, random: np.random.Generator
) -> Picture:
    """By where the ray of each part of a pixel meets the plane of the board, on light grey."""
    normal = rotation[:, 2]
    along = (normal @ middle) / (normal[0] * x + normal[1] * y + normal[2])
    at = []
    for (across, down, forward), size, side in zip(rotation.T[:2], size_m, texture.shape[::-1], strict=True):
        on_board = along * (across * x + down * y + forward) - np.array([across, down, forward]) @ middle
        at.append(((on_board / size + 0.5) * side - 0.5).astype(np.float32))
    at[0][along <= 0] = -texture.shape[1]
    parts = cv2.remap(texture, at[0], at[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(190,))
    grey = _averaged(np.asarray(parts, dtype=np.uint8)[..., None])
    return noisy(np.repeat(0.85 * grey + 15, 3, axis=2), random)


def noisy(picture: Array, random: np.random.Generator) -> Picture:
    """With a sensor's noise."""
    return np.asarray(np.clip(np.rint(picture + random.normal(0, NOISE, picture.shape)), 0, 255), dtype=np.uint8)


@cache
def _directions(lens: TrueLens) -> tuple[Array, Array]:
    steps = (np.arange(SIDE * PARTS) + 0.5) / PARTS - 0.5
    bent_x, bent_y = np.meshgrid((steps - lens.centre[0]) / lens.focal, (steps - lens.centre[1]) / lens.focal)
    x, y, step = bent_x.copy(), bent_y.copy(), 1e-6
    for _ in range(7):
        at_x, at_y = lens.bend(x, y)
        (ax, ay), (bx, by) = lens.bend(x + step, y), lens.bend(x, y + step)
        a, c, b, d = (ax - at_x) / step, (ay - at_y) / step, (bx - at_x) / step, (by - at_y) / step
        off_x, off_y, determinant = bent_x - at_x, bent_y - at_y, a * d - b * c
        x += (d * off_x - b * off_y) / determinant
        y += (a * off_y - c * off_x) / determinant
    return x, y


def _averaged(parts: Picture) -> Array:
    total = sum(parts[row::PARTS, column::PARTS].astype(np.uint16) for row in range(PARTS) for column in range(PARTS))
    return np.asarray(total / PARTS**2, dtype=np.float64)


def _unit(random: np.random.Generator) -> Array:
    direction = random.normal(size=3)
    return np.asarray(direction / np.linalg.norm(direction))
