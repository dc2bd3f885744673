"""Whether covariances are honest when the cameras move too: each sample has other places of both, and another pose.

With cameras that stand still, a marker that stands still is measured with the same error in every frame, and says
nothing about how errors are spread. Frames are measured from files, by the program that people run.

    python bench/moved_cameras.py SEED SAMPLES
"""

import json
import sys

import numpy as np
from pictures import scene  # first: it chooses what MuJoCo draws with

import mujoco  # isort: skip

from armsight_operator.report.markers import CHI2_95, Sample

SHIFT_M = 0.5
TURN_RAD = 0.05


def draw_samples(seed: int, count: int) -> list[Sample]:
    """All markers of ``count`` pairs of pictures.

    Raises:
        subprocess.CalledProcessError: vision refuses the files.
    """
    random = np.random.default_rng(seed)
    samples: list[Sample] = []
    with scene() as arm:
        model, limits = arm.model, arm.world.limits
        position, turn = model.cam_pos.copy(), model.cam_quat.copy()
        for _ in range(count):
            for camera in range(model.ncam):
                model.cam_pos[camera] = position[camera] + random.uniform(-SHIFT_M, SHIFT_M, 3)
                axis = random.normal(size=3)
                small = np.zeros(4)
                mujoco.mju_axisAngle2Quat(small, axis / np.linalg.norm(axis), random.uniform(-TURN_RAD, TURN_RAD))
                mujoco.mju_mulQuat(model.cam_quat[camera], turn[camera], small)
            samples += arm.samples_at(random.uniform(limits[:, 0], limits[:, 1]))
    return samples


if __name__ == "__main__":
    drawn = draw_samples(seed=int(sys.argv[1]), count=int(sys.argv[2]))
    seen = [sample for sample in drawn if not sample.lost]
    within = {
        marker: float(np.mean([sample.d2 < CHI2_95 for sample in seen if sample.marker == marker]))
        for marker in sorted({sample.marker for sample in seen})
    }
    print(json.dumps({"within": within, "wrong": sum(sample.wrong for sample in drawn), "samples": len(drawn)}))
