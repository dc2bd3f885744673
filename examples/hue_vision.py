"""A vision of one's own: the middle of what has a marker's hue, and the point nearest to the rays through it.

python examples/hue_vision.py --connect tcp/127.0.0.1:7447
"""

import argparse

import cv2
import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from scipy.spatial.transform import Rotation

from armsight import topics
from armsight.service import Context, add_service_arguments, run_service
from armsight.v1.description_pb2 import Marker
from armsight.v1.health_pb2 import HEALTH_STATUS_OK
from armsight.v1.joints_pb2 import MARKER_STATUS_LOST, MARKER_STATUS_TRACKED, JointPositions, MarkerPosition

Two = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
HUE, SATURATED, BRIGHT, LEAST_PX, SIGMA_M = 8, 120, 50, 20, 0.05  # the first of OpenCV's 180, to either side


def coloured(image: RawImage) -> Two:
    """What is not grey: columns and rows of pixels (m, 2), and their hues (m,)."""
    hsv = cv2.cvtColor(np.frombuffer(image.data, np.uint8).reshape(image.height, -1, 3), cv2.COLOR_RGB2HSV)
    rows, columns = np.nonzero((hsv[..., 1] > SATURATED) & (hsv[..., 2] > BRIGHT))
    return np.column_stack([columns, rows]), hsv[rows, columns, 0].astype(np.float64)


def ray(seen: Two, marker: Marker, lens: CameraCalibration, pose: FrameTransform) -> Two | None:
    """Through the middle of a marker's hue: where it starts and where it points in the world; nothing if not seen."""
    pure = np.array([[[marker.color.red, marker.color.green, marker.color.blue]]], np.float32)
    like = np.abs((seen[1] - cv2.cvtColor(pure, cv2.COLOR_RGB2HSV)[0, 0, 0] / 2 + 90) % 180 - 90) < HUE
    if like.sum() < LEAST_PX:
        return None
    along = np.linalg.solve(np.reshape(lens.K, (3, 3)), [*seen[0][like].mean(axis=0), 1])
    q, t = pose.rotation, pose.translation
    return np.array([t.x, t.y, t.z]), Rotation.from_quat([q.x, q.y, q.z, q.w]).apply(along / np.linalg.norm(along))


def placed(name: str, rays: list[Two]) -> MarkerPosition:
    """The point nearest to two rays or more; else the marker is lost."""
    found = MarkerPosition(name=name, status=MARKER_STATUS_LOST)
    if len(rays) > 1:
        off = [np.eye(3) - np.outer(along, along) for _, along in rays]
        point = np.linalg.solve(sum(off), sum(each @ start for each, (start, _) in zip(off, rays, strict=True)))
        found.status, found.covariance[:] = MARKER_STATUS_TRACKED, (np.eye(3) * SIGMA_M**2).ravel()
        found.position.x, found.position.y, found.position.z = point
    return found


def body(context: Context) -> None:
    """Answers the instants of which all cameras' frames came."""
    lenses, poses, frames = dict[str, CameraCalibration](), dict[str, FrameTransform](), dict[str, RawImage]()
    hear, out = context.bus.subscriber, context.bus.publisher(topics.JOINT_POSITIONS)
    hear(topics.CAMERA_CALIBRATION, "*", on_message=lambda got: lenses.update({got.name: got.message}))
    hear(topics.CAMERA_POSE, "*", on_message=lambda got: poses.update({got.name: got.message}))
    arm, images = hear(topics.DESCRIPTION), hear(topics.CAMERA_IMAGE, "*", keep=8)
    context.health.report(HEALTH_STATUS_OK)
    while not context.stop.is_set():
        if (got := images.recv(0.1)) and arm.latest:
            frames[got.name] = got.message
            now = {name: image for name, image in frames.items() if image.timestamp == got.message.timestamp}
            if set(now) == set(arm.latest.message.cameras) <= set(lenses) & set(poses):
                seen = {name: coloured(image) for name, image in now.items()}
                answer = JointPositions(capture_time=got.message.timestamp)
                for marker in arm.latest.message.markers:
                    rays = [ray(seen[name], marker, lenses[name], poses[name]) for name in now]
                    answer.markers.append(placed(marker.name, [each for each in rays if each]))
                out.put(answer)


if __name__ == "__main__":
    add_service_arguments(parser := argparse.ArgumentParser())
    raise SystemExit(run_service("vision", parser.parse_args(), {}, body))
