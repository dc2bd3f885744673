"""Pictures of the arm by several cameras at the same instants: which there are, and which of them to measure."""

from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import numpy as np
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from armsight import topics
from armsight.calibration import KnownCamera
from armsight.errors import ConfigError
from armsight.pictures import pictures_in
from armsight.times import NS_PER_S
from armsight.v1.description_pb2 import ArmDescription
from armsight_operator.calibrate.frames import Picture, decoded, read_picture
from armsight_operator.calibrate.lens import Array
from armsight_operator.recording.reader import Recording

STANDS_S = 0.3
"""An accepted setpoint that is this old is where the arm is."""


Joints = Mapping[str, float]
"""Angles in radians by name."""


class Angles(StrEnum):
    """Where the joint angles are known from."""

    ACCEPTED = "accepted"
    TRUE = "true"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Instant:
    """One pose of the arm."""

    key: int | str
    """Capture time in nanoseconds, or the pictures' name."""
    joints: Joints | None
    """Angles in radians; none where they are not known."""


@dataclass(frozen=True, slots=True)
class Footage:
    """Pictures that belong together, and what was recorded with them."""

    source: Path
    names: tuple[str, ...]
    """Of the cameras."""
    instants: tuple[Instant, ...]
    total: int
    """Instants that there are; so many of them were chosen."""
    description: ArmDescription | None = None
    cameras: Mapping[str, KnownCamera] = field(default_factory=dict)
    """As they were published meanwhile."""

    def pictures(self) -> Iterator[tuple[int, str, Picture]]:
        """Index of the instant, camera, and the picture; read one at a time.

        Raises:
            ConfigError: one can't be read.
        """
        index_of = {instant.key: index for index, instant in enumerate(self.instants)}
        if self.source.is_dir():
            for camera in self.names:
                for path in pictures_in(self.source / camera):
                    if path.stem in index_of:
                        yield index_of[path.stem], camera, read_picture(path)
            return
        keys = {topics.CAMERA_IMAGE.key_for(camera): camera for camera in self.names}
        for entry in Recording(self.source).entries(keys):
            if entry.instant_ns in index_of:
                yield index_of[entry.instant_ns], keys[entry.key], decoded(entry)


def find_footage(source: Path, angles: Angles, most: int) -> Footage:
    """The instants of a recording, or of a folder with a folder of pictures for each camera.

    Args:
        source: the recording or folder. In folders pictures of one name are of one instant.
        angles: which angles to take.
        most: how many instants to choose at most: the poses that differ the most, or evenly spaced ones where
            angles are unknown.

    Raises:
        ConfigError: there is no such thing in it.
    """
    if source.is_dir():
        return _in_folder(source, angles, most)
    if not source.is_file() or source.suffix != ".mcap":
        raise ConfigError(
            f"{source} is neither a recording (.mcap) nor a folder with a folder of pictures for each camera"
        )
    return _in_recording(source, angles, most)


def _in_folder(source: Path, angles: Angles, most: int) -> Footage:
    names = tuple(sorted(path.name for path in source.iterdir() if path.is_dir() and pictures_in(path)))
    if not names:
        raise ConfigError(f"{source} has no folder of pictures for each camera, such as {source}/1/0001.png")
    if angles is not Angles.UNKNOWN:
        raise ConfigError(f"pictures in {source} come without angles: give --angles unknown, or a recording")
    stems = [{path.stem for path in pictures_in(source / name)} for name in names]
    common = sorted(set.union(*stems))
    instants = [Instant(common[index], None) for index in _evenly(len(common), most)]
    return Footage(source, names, tuple(instants), len(common))


def _in_recording(source: Path, angles: Angles, most: int) -> Footage:
    description: ArmDescription | None = None
    cameras: dict[str, KnownCamera] = {}
    seen: dict[int, set[str]] = {}
    told: dict[int, Joints] = {}
    topic = topics.JOINTS_TRUE if angles is Angles.TRUE else topics.JOINTS_ACCEPTED
    recording = Recording(source)
    latched = (topics.DESCRIPTION, topics.CAMERA_CALIBRATION, topics.CAMERA_POSE, topic)
    for found, entry, message in recording.messages(latched):
        parts = entry.key.split("/")
        if found is topics.DESCRIPTION:
            description = message
        elif found is topic:
            told[entry.instant_ns] = _angles_of(message)
        else:
            known = cameras.get(parts[1], KnownCamera())
            is_pose = found is topics.CAMERA_POSE
            cameras[parts[1]] = KnownCamera(
                known.calibration if is_pose else message, message if is_pose else known.pose
            )
    names = tuple(sorted(cameras))
    keys = {topics.CAMERA_IMAGE.key_for(camera): camera for camera in names}
    for entry in recording.entries(keys):
        seen.setdefault(entry.instant_ns, set()).add(keys[entry.key])
    if not seen:
        raise ConfigError(f"{source} has no pictures: record camera/*/image, camera/*/calibration and camera/*/pose")
    whole = sorted(stamp for stamp, who in seen.items() if len(who) == len(names))
    if not whole:
        raise ConfigError(f"{source} has no instant with pictures of all cameras: {', '.join(names)}")
    if angles is Angles.UNKNOWN:
        instants = [Instant(whole[index], None) for index in _evenly(len(whole), most)]
        return Footage(source, names, tuple(instants), len(whole), description, cameras)
    poses = _at(told, whole, angles)
    if not poses:
        raise ConfigError(
            f"{source} has no instant with pictures of all cameras and {topic.key}"
            + (f" that stands for {STANDS_S:g} s: let the arm rest at each pose" if angles is Angles.ACCEPTED else "")
        )
    order = [name for name in poses[0][1] if all(name in joints for _, joints in poses)]
    chosen = _different(np.array([[joints[name] for name in order] for _, joints in poses]), most)
    instants = [Instant(poses[index][0], poses[index][1]) for index in chosen]
    return Footage(source, names, tuple(instants), len(poses), description, cameras)


def _angles_of(message: JointStates) -> Joints:
    return {joint.name: joint.position for joint in message.joints}


def _at(told: Mapping[int, Joints], stamps: Sequence[int], angles: Angles) -> list[tuple[int, Joints]]:
    """Those of these instants at which the angles are known, with them."""
    if angles is Angles.TRUE:
        return [(stamp, told[stamp]) for stamp in stamps if stamp in told]
    # what sim and arms accept is published when it changes: the last one before holds, and must have held for a while
    times, found = sorted(told), []
    for stamp in stamps:
        last = bisect_right(times, stamp) - 1
        if last >= 0 and stamp - times[last] >= STANDS_S * NS_PER_S:
            found.append((stamp, told[times[last]]))
    return found


def _evenly(count: int, most: int) -> list[int]:
    return [int(index) for index in np.unique(np.linspace(0, count - 1, min(count, most)).round())] if count else []


def _different(q: Array, most: int) -> list[int]:
    """Farthest from all that are chosen already, and none twice."""
    chosen = [0]
    distance = np.linalg.norm(q - q[0], axis=1)
    while len(chosen) < most and distance.max() > np.radians(1):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(q - q[chosen[-1]], axis=1))
    return sorted(chosen)
