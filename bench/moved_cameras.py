"""Whether covariances are honest when the cameras move too: each sample has other places of both, and another pose.

With cameras that stand still, a marker that stands still is measured with the same error in every frame, and says
nothing about how errors are spread. Frames are measured from files, by the program that people run.

    python bench/moved_cameras.py SEED SAMPLES
"""

import json
import sys

import numpy as np
from pictures import SAMPLES, SIZE, measure  # first: it chooses what MuJoCo draws with

import mujoco  # isort: skip

from armsight_operator.report.chain import arm_of
from armsight_operator.report.markers import CHI2_95, Sample, samples_of
from armsight_sim import description
from armsight_sim.cameras import Cameras
from armsight_sim.world import World, load_model

SHIFT_M = 0.5
TURN_RAD = 0.05


def draw_samples(seed: int, count: int) -> list[Sample]:
    """All markers of ``count`` pairs of pictures.

    Raises:
        subprocess.CalledProcessError: vision refuses the files.
    """
    model = load_model()
    position, turn = model.cam_pos.copy(), model.cam_quat.copy()
    world = World(model, 1 / 30)
    arm = arm_of(description.describe_arm(model))
    names = description.camera_names(model)
    cameras = Cameras(model, names, SIZE, SIZE, SAMPLES)
    random = np.random.default_rng(seed)
    samples: list[Sample] = []
    try:
        for _ in range(count):
            for camera in range(model.ncam):
                model.cam_pos[camera] = position[camera] + random.uniform(-SHIFT_M, SHIFT_M, 3)
                axis = random.normal(size=3)
                small = np.zeros(4)
                mujoco.mju_axisAngle2Quat(small, axis / np.linalg.norm(axis), random.uniform(-TURN_RAD, TURN_RAD))
                mujoco.mju_mulQuat(model.cam_quat[camera], turn[camera], small)
            q = random.uniform(world.limits[:, 0], world.limits[:, 1])
            world.reset(q)
            images = dict(zip(names, map(np.copy, cameras.draw(world.data)), strict=True))
            samples += samples_of(arm, measure(model, images), q, len(names))
    finally:
        cameras.close()
    return samples


if __name__ == "__main__":
    drawn = draw_samples(seed=int(sys.argv[1]), count=int(sys.argv[2]))
    seen = [sample for sample in drawn if not sample.lost]
    within = {
        marker: float(np.mean([sample.d2 < CHI2_95 for sample in seen if sample.marker == marker]))
        for marker in sorted({sample.marker for sample in seen})
    }
    print(json.dumps({"within": within, "wrong": sum(sample.wrong for sample in drawn), "samples": len(drawn)}))
