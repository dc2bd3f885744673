"""Room for frames in the memory that readers on this machine share: a frame is written there and sent as it is.

Zenoh's own way, a put of bytes that it moves there, copies each frame three times.
"""

import logging

import zenoh
from zenoh.shm import GarbageCollect, ShmProvider, ZShmMut

from armsight.counters import Counters
from armsight.images import head_of_rgb8
from armsight.shared_memory import POOL_BYTES, Use, why_not

log = logging.getLogger(__name__)


class FramePool:
    """Encodes frames where they are sent from. Use from one thread."""

    def __init__(self, use: Use, counters: Counters) -> None:
        """Takes the memory, if it is to be used and can be had: :func:`~armsight.shared_memory.why_not`.

        Args:
            use: as the session that sends the frames was opened; only ``publish`` has a pool.
            counters: take the frames that found no room in the pool.
        """
        self._counters = counters
        self._provider: ShmProvider | None = None
        if use != "publish" or why_not(use):
            return
        try:
            self._provider = ShmProvider.default_backend(POOL_BYTES)
        except zenoh.ZError as error:
            log.warning("no shared memory: %s", error)

    def encode_rgb8(
        self, pixels: bytes | bytearray | memoryview, width: int, height: int, frame_id: str, capture_ns: int
    ) -> zenoh.ZBytes:
        """As :func:`armsight.images.encode_rgb8`, in the pool where there is one and it has room.

        What is returned keeps its room until it and all that was sent of it are forgotten: don't keep it.
        """
        head = head_of_rgb8(len(pixels), width, height, frame_id, capture_ns)
        room = self._room(len(head) + len(pixels))
        if room is None:
            return zenoh.ZBytes(b"".join((head, pixels)))
        room[: len(head)] = head
        room[len(head) :] = bytes(pixels) if isinstance(pixels, memoryview) else pixels  # Zenoh takes no view
        return zenoh.ZBytes(room)

    def _room(self, size: int) -> ZShmMut | None:
        if self._provider is None:
            return None
        try:
            return self._provider.alloc(size, GarbageCollect())
        except zenoh.ZError:
            pass
        # what was given back lies in pieces, of frames of another size
        self._provider.garbage_collect()
        self._provider.defragment()  # type: ignore[no-untyped-call]
        try:
            return self._provider.alloc(size)
        except zenoh.ZError:  # readers have it all
            self._counters.add("frames_without_room")
            return None
