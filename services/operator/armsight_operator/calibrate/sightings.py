"""What each camera by itself sees of the markers, by armsight-vision on files.

One picture at a time and with the camera at the origin: what comes out depends on the picture and the lens, and on no
other camera, so that wrong poses can't spoil it. Centres are those of the spheres, not of their images, lens included.
"""

import subprocess
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from google.protobuf.json_format import Parse, ParseError
from PIL import Image

from armsight.calibration import CalibrationFile, KnownCamera, write_calibration_file
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.joints_pb2 import JointPositions
from armsight_operator.calibrate.frames import Picture
from armsight_operator.calibrate.lens import Array, Lens, message_of
from armsight_operator.errors import OperatorError
from armsight_operator.stack.executables import find_executable

_TIMEOUT_S = 60.0


@dataclass(frozen=True, slots=True)
class Sighting:
    """One marker in one picture."""

    marker: str
    pixel: Array
    """Of its centre."""
    radius_px: float
    visible: float
    """Share of the disc, 0 to 1."""
    place: Array
    """Metres in the camera's frame; by the sphere's size, so that its distance is rough."""


class Looker:
    """Measures pictures of one camera after the other; close it."""

    def __init__(self, description: ArmDescription) -> None:
        """Looks for armsight-vision.

        Raises:
            MissingExecutableError: it is not built.
        """
        self._vision = find_executable("vision")
        self._description = ArmDescription()
        self._description.CopyFrom(description)
        del self._description.bodies[:]  # not of the arm
        self._folder = TemporaryDirectory(prefix="armsight-calibrate-")

    def sightings(self, camera: str, lens: Lens, rgb: Picture) -> list[Sighting]:
        """The markers that one picture shows.

        Raises:
            OperatorError: vision can't use it; with what it says.
        """
        calibration, picture = Path(self._folder.name) / "calibration.json", Path(self._folder.name) / "picture.png"
        here = FrameTransform(parent_frame_id="world")
        here.rotation.w = 1.0
        known = KnownCamera(message_of(lens, camera), here)
        write_calibration_file(calibration, CalibrationFile({camera: known}, description=self._description))
        Image.fromarray(rgb).save(picture, compress_level=0)
        words = [str(self._vision), "--calibration", str(calibration), "--image", f"{camera}={picture}"]
        try:
            done = subprocess.run(words, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
        except subprocess.TimeoutExpired as error:
            raise OperatorError(f"armsight-vision took longer than {_TIMEOUT_S:g} s for one picture") from error
        if done.returncode != 0:
            last = (done.stderr.strip().splitlines() or ["it says nothing"])[-1]
            raise OperatorError(f"armsight-vision can't measure a picture of camera {camera}: {last}")
        try:
            positions = Parse(done.stdout, JointPositions())
        except ParseError as error:
            raise OperatorError(f"armsight-vision's answer can't be read: {error}") from error
        return [
            Sighting(
                marker.name,
                np.array([seen.u_px, seen.v_px]),
                seen.radius_px,
                seen.visible,
                np.array([marker.position.x, marker.position.y, marker.position.z]),
            )
            for marker in positions.markers
            for seen in marker.observations
        ]

    def close(self) -> None:
        """Removes what it wrote."""
        self._folder.cleanup()
