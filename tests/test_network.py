"""The faults of `network.py` are what they are taken for, by datagrams that one host sends another."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass

import network
import numpy as np
import pytest
from network import Network, Way, inside

pytestmark = network.NEEDS_ROOT

SENT = 400
PAUSE_S = 0.001
BYTES = 1000

LISTEN = """
import json, socket, sys, time
listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
listener.setsockopt(socket.SOL_SOCKET, 33, 4 << 20)  # SO_RCVBUFFORCE: many may come at once
listener.bind(("0.0.0.0", 5000))
listener.settimeout(float(sys.argv[1]))
print("listens", flush=True)
heard = []
try:
    while True:
        datagram = listener.recv(2000)
        heard.append((*(int.from_bytes(datagram[at : at + 8], "big") for at in (0, 8)), time.time_ns()))
except TimeoutError:
    print(json.dumps(heard))
"""
SEND = """
import socket, sys, time
sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
for number in range(int(sys.argv[2])):
    content = number.to_bytes(8, "big") + time.time_ns().to_bytes(8, "big")
    sender.sendto(content.ljust(int(sys.argv[4])), (sys.argv[1], 5000))
    time.sleep(float(sys.argv[3]))
"""


@dataclass(frozen=True, slots=True)
class Heard:
    """What arrived, in that order."""

    numbers: np.ndarray
    delays_s: np.ndarray
    span_s: float
    """From when the first was sent until the last arrived."""


@pytest.fixture(scope="module")
def two() -> Iterator[Network]:
    with network.hosts(("here", "there")) as made:
        yield made


def datagrams(net: Network, sender: str = "here", receiver: str = "there") -> Heard:
    """Sends some; a second of silence ends it."""
    listen = [*inside(net.namespace_of(receiver)), sys.executable, "-c", LISTEN, "1.0"]
    with subprocess.Popen(listen, stdout=subprocess.PIPE, text=True) as listener:
        assert listener.stdout is not None
        assert listener.stdout.readline() == "listens\n"
        send = [sys.executable, "-c", SEND, net.address(receiver), str(SENT), str(PAUSE_S), str(BYTES)]
        subprocess.run([*inside(net.namespace_of(sender)), *send], check=True, timeout=20)
        heard = np.array(json.loads(listener.stdout.readline()), dtype=np.int64).reshape(-1, 3)
    numbers, sent_ns, heard_ns = heard.T
    return Heard(
        numbers, (heard_ns - sent_ns) / 1e9, float(heard_ns.max() - sent_ns.min()) / 1e9 if len(heard) else 0.0
    )


def test_everything_arrives_at_once_and_in_order_where_there_is_no_fault(two: Network) -> None:
    heard = datagrams(two)
    assert (heard.numbers == np.arange(SENT)).all()
    assert np.median(heard.delays_s) < 0.002


def test_delay_and_jitter_are_what_was_asked_for(two: Network) -> None:
    with two.held(["here"], delay_ms=50, jitter_ms=20, seed=1):
        heard = datagrams(two)
    assert len(heard.numbers) == SENT
    assert heard.delays_s.min() > 0.029
    assert 0.045 < np.median(heard.delays_s) < 0.056
    assert np.quantile(heard.delays_s, 0.9) > 0.060


def test_held_packets_are_overtaken_by_the_share_that_was_asked_for(two: Network) -> None:
    with two.held(["there"], delay_ms=10, overtaking=0.25, correlation=0.5, seed=1):
        heard = datagrams(two)
    assert sorted(heard.numbers) == list(range(SENT))
    assert (np.diff(heard.numbers) < 0).any()
    # netem's correlation makes less than a quarter of it
    assert 0.03 < (heard.delays_s < 0.005).mean() < 0.35


def test_share_of_the_packets_is_lost(two: Network) -> None:
    with two.lossy(["here"], share=0.1):
        heard = datagrams(two)
    assert 0.04 < 1 - len(heard.numbers) / SENT < 0.17  # within four standard deviations


def test_slow_cable_carries_no_more_than_its_rate(two: Network) -> None:
    with two.slow(["here"], mbit_s=1):
        heard = datagrams(two)
    assert 0.5 < (len(heard.numbers) * BYTES - 16e3) * 8 / heard.span_s / 1e6 < 1.0  # 16 kB go at once
    assert heard.delays_s.max() < 0.6


@pytest.mark.parametrize(("way", "arrives"), [("to", True), ("from", False), ("both", False)])
def test_partition_is_of_the_ways_that_were_asked_for(two: Network, way: Way, arrives: bool) -> None:
    with two.cut(["here"], way):
        assert (len(datagrams(two).numbers) == SENT) == arrives
        assert (len(datagrams(two, "there", "here").numbers) == SENT) == (way == "from")


def test_nothing_is_left_of_a_fault(two: Network) -> None:
    for fault in (two.held(["here"], delay_ms=50), two.lossy(["here"], 1.0), two.slow(["here"], 1), nullcontext()):
        with fault:
            pass
    assert len(datagrams(two).numbers) == SENT


@pytest.mark.parametrize("fault", ["held", "slow"])
def test_what_a_fault_holds_up_arrives_when_it_ends(two: Network, fault: str) -> None:
    # more than it passes on, less than it holds
    with ExitStack() as undo:
        undo.enter_context(two.held(["here"], delay_ms=5000) if fault == "held" else two.slow(["here"], mbit_s=5))
        with ThreadPoolExecutor(1) as sending:
            heard = sending.submit(datagrams, two)
            time.sleep(0.35)
            undo.close()
    delays_s = heard.result().delays_s
    assert len(delays_s) == SENT
    assert delays_s.max() > 0.02, "nothing was sent before it ended"
    assert delays_s.max() < 1.0
