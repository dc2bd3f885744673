"""What vision makes of given poses, marker by marker: for whoever looks for the cause of one error.

python bench/poses.py 0,-1.53,1.53,0.67 3.06,0.93,1.57,1.39
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from pictures import SAMPLES, SIZE, measure  # first: it chooses what MuJoCo draws with

from armsight_operator.report.chain import arm_of
from armsight_operator.report.markers import samples_of
from armsight_sim import description
from armsight_sim.cameras import Cameras
from armsight_sim.world import World, load_model


def samples_at(poses: Sequence[Sequence[float]]) -> list[dict[str, Any]]:
    """Every marker of every pose, angles in radians.

    Raises:
        subprocess.CalledProcessError: vision refuses the files.
    """
    model = load_model()
    world = World(model, 1 / 30)
    arm = arm_of(description.describe_arm(model))
    names = description.camera_names(model)
    cameras = Cameras(model, names, SIZE, SIZE, SAMPLES)
    found = []
    try:
        for pose in poses:
            world.reset(np.array(pose))
            images = dict(zip(names, map(np.copy, cameras.draw(world.data)), strict=True))
            samples = samples_of(arm, measure(model, images), np.array(pose), len(names))
            found += [{"pose": list(pose), **asdict(sample)} for sample in samples]
    finally:
        cameras.close()
    return found


if __name__ == "__main__":
    print(json.dumps(samples_at([[float(angle) for angle in pose.split(",")] for pose in sys.argv[1:]])))
