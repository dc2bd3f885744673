"""Recordings of a made-up run, for tests of what reads them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from armsight import topics
from armsight.bus import Sample
from armsight.images import encode_rgb8
from armsight.times import to_timestamp
from armsight.topics import Topic
from armsight.v1.joints_pb2 import MARKER_STATUS_TRACKED, JointPositions
from armsight.v1.sim_pb2 import CLOCK_MODE_LOCKSTEP, Clock
from armsight_operator.recording.backlog import Arrival
from armsight_operator.recording.series import Limits, Series
from fake_arm import NAMES, description

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 33_333_333
ARRIVES_NS = 5_000_000_000
"""After the instant that it tells of: log time is not capture time."""


def messages(instants: int, side: int = 16) -> Iterator[tuple[Topic[Any], str, int, bytes]]:
    """Topic, name, instant and bytes of everything that a run puts on the bus, in order."""
    yield topics.DESCRIPTION, "", START_NS, description().SerializeToString()
    for camera in ("1", "2"):
        calibration = CameraCalibration(timestamp=to_timestamp(START_NS), width=side, height=side)
        yield topics.CAMERA_CALIBRATION, camera, START_NS, calibration.SerializeToString()
    for number in range(instants):
        stamp_ns = START_NS + number * PERIOD_NS
        stamp = to_timestamp(stamp_ns)
        clock = Clock(capture_time=stamp, mode=CLOCK_MODE_LOCKSTEP, frame=number)
        yield topics.CLOCK, "", stamp_ns, clock.SerializeToString()
        for camera in ("1", "2"):
            pixels = bytes((number + row * 7) % 256 for row in range(side)) * side * 3
            yield topics.CAMERA_IMAGE, camera, stamp_ns, encode_rgb8(pixels, side, side, f"camera_{camera}", stamp_ns)
        positions = JointPositions(capture_time=stamp)
        marker = positions.markers.add(
            name="red", status=MARKER_STATUS_TRACKED, covariance=[1e-6, 0, 0, 0, 1e-6, 0, 0, 0, 1e-6]
        )
        marker.position.x = 0.01 * number
        yield topics.JOINT_POSITIONS, "", stamp_ns, positions.SerializeToString()
        joints = [JointState(name=name, position=0.1 * number) for name in NAMES]
        states = JointStates(timestamp=stamp, joints=joints).SerializeToString()
        yield topics.JOINTS_ESTIMATED, "", stamp_ns, states
        yield topics.JOINTS_TRUE, "", stamp_ns, states


def arrivals(instants: int, side: int = 16) -> Iterator[Arrival]:
    """The same as they come to a recorder, numbered by key."""
    sequences: dict[str, int] = {}
    for topic, name, stamp_ns, payload in messages(instants, side):
        sample = Sample(topic, name, payload, b"")
        sequences[sample.key] = sequences.get(sample.key, 0) + 1
        yield Arrival(sample, stamp_ns + ARRIVES_NS, sequences[sample.key])


def record(
    path: Path, instants: int = 10, limits: Limits | None = None, *, side: int = 16, flush_every: int = 0
) -> Series:
    """A finished recording."""
    series = Series(path, limits or Limits(), {"namespace": "robots/arm"})
    for number, arrival in enumerate(arrivals(instants, side)):
        series.write(arrival)
        if flush_every and number % flush_every == 0:
            series.flush()
    series.finish("asked to stop", {})
    return series
