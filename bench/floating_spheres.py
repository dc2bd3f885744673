"""How exact vision is where nothing is in the way: the markers alone, drawn three times as fine and averaged down.

What is left then is the measurement itself: no link hides a part of an outline, and the sampling of the renderer is
averaged out. Frames are measured from files, by the program that people run.

    python bench/floating_spheres.py SEED POSES
"""

import json
import sys
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
from pictures import SAMPLES, SIZE, measure  # first: it chooses what MuJoCo draws with

import mujoco  # isort: skip

from armsight_sim import description
from armsight_sim.cameras import Cameras, Commission
from armsight_sim.world import World, load_model

FINER = 3
_WHOLE = 0.97
"""Visible share of a marker that no other hides: of the pixels on its outline some are never in its mask."""


def measure_errors_px(seed: int, poses: int) -> npt.NDArray[np.float64]:
    """Distances of measured from true projected centres, of every marker in every view that nothing hides.

    Raises:
        subprocess.CalledProcessError: vision refuses the files.
    """
    model = _markers_alone()
    world = World(model, 1 / 30)
    names = description.camera_names(model)
    cameras = Cameras(Commission(model, names, FINER * SIZE, FINER * SIZE, SAMPLES))
    random = np.random.default_rng(seed)
    errors: list[float] = []
    try:
        for _ in range(poses):
            world.reset(random.uniform(world.limits[:, 0], world.limits[:, 1]))
            images = dict(zip(names, map(_averaged, cameras.draw(world.data)), strict=True))
            errors += _errors(world, images)
    finally:
        cameras.close()
    return np.array(errors)


def _markers_alone() -> mujoco.MjModel:
    model = load_model()
    model.vis.global_.offwidth = model.vis.global_.offheight = FINER * SIZE
    for index in range(model.ngeom):
        name = model.geom(index).name
        if name == "base" or name.startswith("link_"):
            model.geom_rgba[index, 3] = 0.0
    return model


def _averaged(fine: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    blocks = fine.reshape(SIZE, FINER, SIZE, FINER, 3).mean(axis=(1, 3))
    return np.asarray(np.rint(blocks), dtype=np.uint8)


def _errors(world: World, images: dict[str, npt.NDArray[np.uint8]]) -> Iterator[float]:
    for marker in measure(world.model, images).markers:
        centre = world.data.geom(f"marker_{marker.name}").xpos
        for seen in marker.observations:
            if seen.visible >= _WHOLE:
                yield float(np.linalg.norm(_projected(world, seen.camera, centre) - (seen.u_px, seen.v_px)))


def _projected(world: World, name: str, point: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Pixels of the wire (integer = pixel centre), from MuJoCo's own camera; it looks along its -z, y up."""
    camera = world.data.camera(name)
    x, y, z = camera.xmat.reshape(3, 3).T @ (point - camera.xpos)
    focal = SIZE / 2 / np.tan(np.radians(world.model.camera(name).fovy[0]) / 2)
    return np.array([SIZE / 2 + focal * x / -z, SIZE / 2 - focal * y / -z]) - 0.5


if __name__ == "__main__":
    found = measure_errors_px(seed=int(sys.argv[1]), poses=int(sys.argv[2]))
    print(json.dumps({"samples": len(found), "mean_px": found.mean(), "p99_px": np.percentile(found, 99)}))
