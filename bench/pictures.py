"""Pictures drawn here and measured by the program that people run, without a bus between them."""

# ruff: noqa: E402

from armsight_sim.gl import choose_gl

choose_gl()  # before anything imports MuJoCo

import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.json_format import Parse

from armsight.v1.joints_pb2 import JointPositions
from armsight_operator.picture import write_snapshot
from armsight_operator.picture.snapshot import CALIBRATION, CameraSnapshot, Snapshot
from armsight_operator.report.chain import arm_of
from armsight_operator.report.markers import Sample, samples_of
from armsight_operator.stack.executables import find_executable
from armsight_sim import description
from armsight_sim.cameras import Cameras, Commission
from armsight_sim.world import World, load_model

SIZE = 800
SAMPLES = 4


def measure(model: mujoco.MjModel, images: Mapping[str, npt.NDArray[np.uint8]]) -> JointPositions:
    """What armsight-vision finds in one picture of each camera, with the cameras where the model has them.

    Raises:
        subprocess.CalledProcessError: vision refuses the files.
    """
    snapshot = Snapshot(
        0,
        description.describe_arm(model),
        {
            name: CameraSnapshot(
                description.calibration(model, name, SIZE, SIZE, 0),
                description.camera_pose(model, name, 0),
                RawImage(width=SIZE, height=SIZE, encoding="rgb8", step=3 * SIZE, data=image.tobytes()),
            )
            for name, image in images.items()
        },
    )
    with tempfile.TemporaryDirectory() as folder:
        files = write_snapshot(snapshot, Path(folder))
        command = [str(find_executable("vision")), "--calibration", str(Path(folder) / CALIBRATION)]
        command += [f"--image={name}={path}" for name, path in files.items()]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    return Parse(done.stdout, JointPositions())


class Scene:
    """The arm before its cameras; a camera may be moved in ``model`` between pictures."""

    def __init__(self, cameras: Cameras, model: mujoco.MjModel) -> None:
        """Draws with cameras of this model."""
        self.model = model
        self.world = World(model, 1 / 30)
        self._cameras, self._names = cameras, description.camera_names(model)
        self._arm = arm_of(description.describe_arm(model))

    def samples_at(self, q: npt.NDArray[np.float64]) -> list[Sample]:
        """What vision makes of the arm at ``q``, radians, marker by marker.

        Raises:
            subprocess.CalledProcessError: vision refuses the files.
        """
        self.world.reset(q)
        images = dict(zip(self._names, map(np.copy, self._cameras.draw(self.world.data)), strict=True))
        return samples_of(self._arm, measure(self.model, images), q, len(self._names))


@contextmanager
def scene() -> Iterator[Scene]:
    """Opens the cameras, and closes them."""
    model = load_model()
    cameras = Cameras(Commission(model, description.camera_names(model), SIZE, SIZE, SAMPLES))
    try:
        yield Scene(cameras, model)
    finally:
        cameras.close()
