"""Robots that are filmed: frames of a snapshot, sent again and again under the names of several robots."""

import multiprocessing
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from multiprocessing.sharedctypes import Synchronized
from multiprocessing.synchronize import Event

from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from running import bus_of

from armsight import topics
from armsight.bus import Bus
from armsight.frame_pool import FramePool
from armsight.images import encode_sent
from armsight.shared_memory import Use
from armsight.times import wall_ns
from armsight_operator.picture import Snapshot, take_snapshot
from armsight_operator.stack import Stack

_SENDERS = 2
_SPAWN = multiprocessing.get_context("spawn")


@dataclass(frozen=True, slots=True)
class Senders:
    """Processes that film; there are two, for more than one robot: one sends no more than a processor can."""

    pids: tuple[int, ...]
    _sent: "tuple[Synchronized[int], ...]"

    def sent(self) -> int:
        """Instants that were sent so far, of all robots."""
        return sum(each.value for each in self._sent)


def snapshot() -> Snapshot:
    """One instant of sim's arm, of a simulation that has ended when this returns."""
    with Stack(target="none", mode="hold") as stack:
        stack.start("router")
        stack.start("sim")
        with bus_of(stack.endpoint, stack.namespace) as bus:
            return take_snapshot(bus, timeout_s=30.0)


@contextmanager
def filmed(
    endpoint: str, namespaces: Sequence[str], taken: Snapshot, rate_hz: float, shared_memory: bool
) -> Iterator[Senders]:
    """Other processes send the snapshot's frames under each of the names, that often and in turn within a period."""
    done = _SPAWN.Event()
    memory: Use = "publish" if shared_memory else "off"
    shares = [namespaces[first::_SENDERS] for first in range(min(_SENDERS, len(namespaces)))]
    counts: tuple[Synchronized[int], ...] = tuple(_SPAWN.Value("q", 0) for _ in shares)
    packed = _packed(taken)
    processes = [
        _SPAWN.Process(target=_film, args=(endpoint, tuple(share), packed, rate_hz, memory, sent, done), daemon=True)
        for share, sent in zip(shares, counts, strict=True)
    ]
    for process in processes:
        process.start()
    try:
        yield Senders(tuple(process.pid for process in processes if process.pid is not None), counts)
    finally:
        done.set()
        for process in processes:
            process.join(10)
            if process.is_alive():
                process.kill()
                process.join()


_Packed = tuple[bytes, dict[str, tuple[bytes, bytes, bytes]]]
"""The description; by camera its calibration, its pose and its image: messages go to no other process as they are."""


def _packed(taken: Snapshot) -> _Packed:
    cameras = {
        name: (
            camera.calibration.SerializeToString(),
            camera.pose.SerializeToString(),
            camera.image.SerializeToString(),
        )
        for name, camera in taken.cameras.items()
    }
    return taken.description.SerializeToString(), cameras


class _Robot:
    """Sim's part of one robot's bus."""

    def __init__(self, bus: Bus, packed: _Packed, memory: Use) -> None:
        description, cameras = packed
        self._pool = FramePool(memory, bus.counters)
        self._frames = {}
        for name, (calibration, pose, image) in cameras.items():
            bus.publisher(topics.CAMERA_CALIBRATION, name).put_bytes(calibration)
            bus.publisher(topics.CAMERA_POSE, name).put_bytes(pose)
            self._frames[name] = bus.publisher(topics.CAMERA_IMAGE, name), RawImage.FromString(image)
        bus.publisher(topics.DESCRIPTION).put_bytes(description)

    def film(self) -> None:
        capture_ns = wall_ns()
        for publisher, image in self._frames.values():
            encoded = self._pool.encode_rgb8(image.data, image.width, image.height, image.frame_id, capture_ns)
            publisher.put_bytes(encoded, encode_sent(wall_ns()))


def _film(
    endpoint: str,
    namespaces: Sequence[str],
    packed: _Packed,
    rate_hz: float,
    memory: Use,
    sent: "Synchronized[int]",
    done: Event,
) -> None:
    with ExitStack() as closing:
        robots = [_Robot(closing.enter_context(bus_of(endpoint, name, memory)), packed, memory) for name in namespaces]
        step_s = 1 / rate_hz / len(robots)
        due = time.monotonic()
        while not done.is_set():
            for robot in robots:
                # whoever is late does not catch up: a camera would not either
                due = max(due + step_s, time.monotonic() - step_s)
                time.sleep(max(0.0, due - time.monotonic()))
                robot.film()
                sent.value += 1  # nobody else writes it
