import resource
import threading
from collections.abc import Callable
from typing import Literal

import numpy as np
import pytest
import zenoh

from armsight.counters import Counters
from armsight.frame_pool import FramePool
from armsight.images import encode_rgb8
from armsight.session import SessionConfig, open_session
from armsight.shared_memory import POOL_BYTES, Use, why_not

STAMP_NS = 1_700_000_000_123_456_789
SIDE = 800
FRAME_BYTES = SIDE * SIDE * 3


@pytest.fixture
def counters() -> Counters:
    return Counters()


@pytest.fixture
def pool(counters: Counters) -> FramePool:
    assert why_not("publish") == "", "needed here: `ulimit -l` of 8192 kB and room in /dev/shm"
    return FramePool("publish", counters)


def opened(endpoint: str, use: Use, mode: Literal["client", "router"] = "client") -> zenoh.Session:
    config = SessionConfig(mode=mode, endpoints=(endpoint,), namespace="", shared_memory=use)
    session = open_session(config, threading.Event())
    assert session is not None
    return session


def pixels(side: int = SIDE, seed: int = 7) -> bytes:
    return np.random.default_rng(seed).integers(0, 256, side * side * 3, dtype=np.uint8).tobytes()


def encoded(pool: FramePool, side: int = SIDE) -> zenoh.ZBytes:
    return pool.encode_rgb8(pixels(side), side, side, "camera_1_optical", STAMP_NS)


def test_reader_has_it_by_shared_memory_and_others_by_bytes(pool: FramePool, endpoint: str) -> None:
    expected = encode_rgb8(pixels(), SIDE, SIDE, "camera_1_optical", STAMP_NS)
    with (
        opened(endpoint, "read", mode="router"),
        opened(endpoint, "publish") as here,
        opened(endpoint, "read") as near,
        opened(endpoint, "off") as far,
    ):
        publisher = here.declare_publisher("frame")
        readers = [each.declare_subscriber("frame", zenoh.handlers.FifoChannel(8)) for each in (near, far)]
        for reader, shared in zip(readers, (True, False), strict=True):
            sample = reader.try_recv()
            while sample is None:
                publisher.put(encoded(pool))
                threading.Event().wait(0.05)
                sample = reader.try_recv()
            assert (sample.payload.as_shm() is not None) is shared
            assert sample.payload.to_bytes() == expected


@pytest.mark.parametrize("use", ["read", "off"])
def test_without_a_pool_it_is_the_same_bytes(counters: Counters, use: Use) -> None:
    frame = encoded(FramePool(use, counters))
    assert frame.as_shm() is None
    assert frame.to_bytes() == encode_rgb8(pixels(), SIDE, SIDE, "camera_1_optical", STAMP_NS)


def test_what_finds_no_room_is_bytes_and_counted_until_there_is_room_again(pool: FramePool, counters: Counters) -> None:
    kept = [encoded(pool) for _ in range(POOL_BYTES // FRAME_BYTES)]
    assert all(frame.as_shm() is not None for frame in kept)
    assert encoded(pool).as_shm() is None
    assert counters.snapshot() == {"frames_without_room": 1}
    kept.clear()
    assert encoded(pool).as_shm() is not None
    assert counters.snapshot() == {"frames_without_room": 1}


def test_room_of_frames_of_another_size_is_used_again(pool: FramePool, counters: Counters) -> None:
    for side in (800, 801, 400, 1200, 333, 800, 1300, 16, 1300):
        frame = encoded(pool, side)
        assert frame.as_shm() is not None
        assert len(frame) > side * side * 3
        del frame
    assert counters.snapshot() == {}


def test_bytes_that_do_not_fit_the_picture_are_refused(pool: FramePool) -> None:
    with pytest.raises(ValueError, match="are not a 800x800"):
        pool.encode_rgb8(bytes(5), SIDE, SIDE, "camera_1_optical", STAMP_NS)


def test_process_that_may_not_lock_goes_without(counters: Counters, monkeypatch: pytest.MonkeyPatch) -> None:
    low: Callable[[int], tuple[int, int]] = lambda _: (65536, 65536)  # noqa: E731
    monkeypatch.setattr(resource, "getrlimit", low)
    monkeypatch.setattr("armsight.shared_memory._has_capability", lambda _: False)
    assert encoded(FramePool("publish", counters)).as_shm() is None
