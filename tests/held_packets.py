"""A program that holds packets: those that Netfilter puts in a queue go on later, and not all in their order.

It stands for `tc netem`'s delay and reorder, which many kernels come without. Only the packets' numbers pass through
here, so that it keeps up with what a cable carries. `network.py` starts it, in the namespace whose packets it holds; it
says a line when it listens, and ends by SIGTERM, letting go what it still holds.
"""

import argparse
import heapq
import select
import signal
import socket
import struct
import sys
import time
from dataclasses import dataclass, field
from random import Random

_NETLINK_NETFILTER = 12
_QUEUE = 3 << 8
"""Netfilter's subsystem of queues; its messages (linux/netfilter/nfnetlink_queue.h):"""
_PACKET, _VERDICT, _CONFIG = _QUEUE, _QUEUE | 1, _QUEUE | 2
_REQUEST, _ACKNOWLEDGE = 1, 4
_CONFIG_COMMAND, _CONFIG_PARAMETERS, _CONFIG_LENGTH, _CONFIG_MASK, _CONFIG_FLAGS = 1, 2, 3, 4, 5
_BIND, _COPY_NUMBER_ONLY, _WITHOUT_SEGMENTING = 1, 1, 1 << 2
_VERDICT_HEADER, _ACCEPT = 2, 1

_MOST_HELD = 200_000
"""Packets: two seconds of a cable that carries frames, where Netfilter would drop what is beyond 1,024."""
_BUFFER_BYTES = 64 << 20
_HEADER = struct.Struct("=IHHII")
_NUMBER = struct.Struct("!I")
_NUMBER_AT = 24
"""Netlink's header, Netfilter's, that of the first attribute: a packet's number follows."""


@dataclass(slots=True)
class Delays:
    """How long each packet is held, in seconds: as netem's `delay TIME JITTER reorder SHARE CORRELATION` has it."""

    delay_s: float
    jitter_s: float
    overtaking: float
    """Share of the packets that are not held, and so overtake others."""
    correlation: float
    """Of that with the packet before, 0 to 1."""
    random: Random
    _last: float = field(default=0.5)

    def next(self) -> float:
        """Of the next packet."""
        if self.overtaking > 0.0:
            self._last = (1 - self.correlation) * self.random.random() + self.correlation * self._last
            if self._last < self.overtaking:
                return 0.0
        return max(0.0, self.delay_s + self.jitter_s * self.random.uniform(-1.0, 1.0))


def _attribute(kind: int, content: bytes) -> bytes:
    return struct.pack("=HH", 4 + len(content), kind) + content + bytes(-len(content) % 4)


def _message(kind: int, flags: int, queue: int, *attributes: bytes) -> bytes:
    content = struct.pack("!BBH", 0, 0, queue) + b"".join(attributes)
    return _HEADER.pack(_HEADER.size + len(content), kind, flags, 0, 0) + content


def _listen(queue: int) -> socket.socket:
    netlink = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, _NETLINK_NETFILTER)
    netlink.bind((0, 0))
    netlink.setsockopt(socket.SOL_SOCKET, 33, _BUFFER_BYTES)  # SO_RCVBUFFORCE
    for attributes in (
        [_attribute(_CONFIG_COMMAND, struct.pack("!BxH", _BIND, socket.AF_INET))],
        [
            _attribute(_CONFIG_PARAMETERS, struct.pack("!IB", 0, _COPY_NUMBER_ONLY)),
            _attribute(_CONFIG_LENGTH, _NUMBER.pack(_MOST_HELD)),
            _attribute(_CONFIG_FLAGS, _NUMBER.pack(_WITHOUT_SEGMENTING)),
            _attribute(_CONFIG_MASK, _NUMBER.pack(_WITHOUT_SEGMENTING)),
        ],
    ):
        netlink.send(_message(_CONFIG, _REQUEST | _ACKNOWLEDGE, queue, *attributes))
        answer = netlink.recv(4096)
        (error,) = struct.unpack_from("=i", answer, _HEADER.size)
        if error != 0:
            raise OSError(-error, "Netfilter refuses the queue")
    return netlink


def hold(queue: int, delays: Delays) -> None:
    """Holds and lets go until SIGTERM."""
    netlink = _listen(queue)
    ended = False

    def end(*_: object) -> None:
        nonlocal ended
        ended = True

    signal.signal(signal.SIGTERM, end)
    print(f"holds queue {queue}", flush=True)
    held: list[tuple[float, int]] = []

    def let_go(until_s: float) -> None:
        while held and held[0][0] <= until_s:
            verdict = struct.pack("!II", _ACCEPT, heapq.heappop(held)[1])
            netlink.send(_message(_VERDICT, _REQUEST, queue, _attribute(_VERDICT_HEADER, verdict)))

    def take(wait_s: float) -> bool:
        if not select.select([netlink], [], [], wait_s)[0]:
            return False
        heard = netlink.recv(65536)
        now = time.monotonic()
        at = 0
        while at + _HEADER.size <= len(heard):
            length, kind, *_ = _HEADER.unpack_from(heard, at)
            if kind == _PACKET:
                heapq.heappush(held, (now + delays.next(), _NUMBER.unpack_from(heard, at + _NUMBER_AT)[0]))
            at += (length + 3) & ~3
        return True

    while not ended:
        take(min(max(0.0, held[0][0] - time.monotonic()), 0.1) if held else 0.1)
        let_go(time.monotonic())
    while take(0.0):  # what it has not been told of by now would be dropped with the queue
        pass
    let_go(float("inf"))


def main() -> int:
    """Reads the flags and holds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--queue", type=int, required=True)
    parser.add_argument("--delay-ms", type=float, required=True)
    parser.add_argument("--jitter-ms", type=float, default=0.0)
    parser.add_argument("--overtaking", type=float, default=0.0, help="share of the packets that are not held")
    parser.add_argument("--correlation", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    delay_s, jitter_s = asked.delay_ms / 1e3, asked.jitter_ms / 1e3
    hold(asked.queue, Delays(delay_s, jitter_s, asked.overtaking, asked.correlation, Random(asked.seed)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
