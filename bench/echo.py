"""A plain Zenoh echo of the bytes that the loop moves: the physical reference for its latency.

One process puts two frames at a time through a router, another answers the second of each pair with as many bytes as a
command has. No message is decoded and nothing is computed.
"""

import argparse
import json
import multiprocessing
import struct
import threading
import time
from collections.abc import Sequence

import zenoh

from armsight.session import SessionConfig, zenoh_settings
from armsight.shared_memory import POOL_BYTES, Use

FRAME_BYTES = 800 * 800 * 3
ANSWER_BYTES = 250
_STAMP = struct.Struct("<Q")


def measure(endpoint: str, pairs: int, rate_hz: float, shared_memory: bool) -> list[float]:
    """Milliseconds from the put of a pair to the arrival of its answer, one for each pair.

    Args:
        endpoint: a running router.
        pairs: how many pairs of frames to send.
        rate_hz: pairs a second.
        shared_memory: whether frames may go through shared memory.

    Raises:
        RuntimeError: more than a tenth of the pairs was lost.
    """
    spawn = multiprocessing.get_context("spawn")
    ready, done = spawn.Event(), spawn.Event()
    echo = spawn.Process(target=_answer, args=(endpoint, shared_memory, ready, done), daemon=True)
    echo.start()
    try:
        if not ready.wait(20):
            raise RuntimeError(f"the echo process did not join the bus at {endpoint}")
        return _send(endpoint, pairs, rate_hz, shared_memory)
    finally:
        done.set()
        echo.join(5)


def _session(endpoint: str, publish: bool, shared_memory: bool) -> zenoh.Session:
    memory: Use = ("publish" if publish else "read") if shared_memory else "off"
    settings = zenoh_settings(SessionConfig(endpoints=(endpoint,), namespace="bench/echo", shared_memory=memory))
    if shared_memory and publish:  # bytes go there by themselves: Zenoh's own way
        pool = {"enabled": True, "pool_size": POOL_BYTES, "message_size_threshold": 65536}
        settings.insert_json5("transport/shared_memory/transport_optimization", json.dumps(pool))
    return zenoh.open(settings)


def _answer(endpoint: str, shared_memory: bool, ready, done) -> None:  # type: ignore[no-untyped-def]
    with _session(endpoint, False, shared_memory) as session:
        publisher = session.declare_publisher("answer", priority=zenoh.Priority.REAL_TIME, express=True)
        frames = session.declare_subscriber("frame/*", zenoh.handlers.RingChannel(4))

        def read() -> None:
            while True:
                try:
                    sample = frames.recv()
                except zenoh.ZError:
                    return
                if str(sample.key_expr).endswith("2"):
                    publisher.put(sample.payload.to_bytes()[:8] + bytes(ANSWER_BYTES - 8))

        threading.Thread(target=read, daemon=True).start()
        ready.set()
        done.wait()


def _send(endpoint: str, pairs: int, rate_hz: float, shared_memory: bool) -> list[float]:
    latencies: list[float] = []
    padding = bytes(FRAME_BYTES - 8)
    with _session(endpoint, True, shared_memory) as session:
        publishers = [
            session.declare_publisher(
                f"frame/{camera}",
                priority=zenoh.Priority.DATA_LOW,
                congestion_control=zenoh.CongestionControl.DROP,
            )
            for camera in (1, 2)
        ]
        answers = session.declare_subscriber("answer", zenoh.handlers.RingChannel(4))

        def read() -> None:
            while True:
                try:
                    sample = answers.recv()
                except zenoh.ZError:
                    return
                latencies.append((time.monotonic_ns() - _STAMP.unpack(sample.payload.to_bytes()[:8])[0]) / 1e6)

        threading.Thread(target=read, daemon=True).start()
        while not publishers[1].matching_status:
            time.sleep(0.01)
        start = time.monotonic()
        for index in range(pairs):
            time.sleep(max(0.0, start + index / rate_hz - time.monotonic()))
            frame = _STAMP.pack(time.monotonic_ns()) + padding
            for publisher in publishers:
                publisher.put(frame)
        time.sleep(0.3)
    if len(latencies) < 0.9 * pairs:
        raise RuntimeError(f"the echo lost {pairs - len(latencies)} of {pairs} pairs")
    return latencies


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures against a router that is running already."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447")
    parser.add_argument("--pairs", type=int, default=300)
    options = parser.parse_args(arguments)
    for shared_memory in (False, True):
        values = sorted(measure(options.connect, options.pairs, 30.0, shared_memory))
        name = "shared memory" if shared_memory else "TCP"
        print(f"{name}: p50 {values[len(values) // 2]:.2f} ms, p99 {values[int(len(values) * 0.99)]:.2f} ms")


if __name__ == "__main__":
    main()
