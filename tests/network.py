"""Hosts on a network of the test's own: network namespaces with a cable each to one that routes, and faults on a cable.

Loss and partitions are Netfilter's, where the network routes: whoever sent a packet does not learn of it. The rate is
`tc tbf`'s at both ends of a cable. Delay and reordering are `held_packets.py`'s, because `tc netem` is in few kernels
of virtual machines. A host's packets are no longer than a cable's 1,500 bytes: none loses or holds many at once.
"""

import os
import secrets
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pytest

from armsight_operator.stack import Stack

Way = Literal["to", "from", "both"]
"""The packets to a host, those from it, or both."""

MAY_MAKE_NETWORKS = os.geteuid() == 0 and shutil.which("ip") is not None

NEEDS_ROOT = pytest.mark.skipif(
    not MAY_MAKE_NETWORKS and "ARMSIGHT_CI" not in os.environ, reason="makes a network namespace: needs root"
)

_SEGMENTS = 65535
"""Linux's own: packets of one cable's length that a host may hand over as one."""
_QUEUED_MS = 400
"""What a slow cable's ends queue before they drop."""


def ip(*words: str) -> None:
    _run("ip", *words)


def inside(name: str) -> list[str]:
    """What stands before a command that is to run in a namespace."""
    return ["ip", "netns", "exec", name]


@contextmanager
def namespace(name: str) -> Iterator[None]:
    """A network of its own; with it goes every cable that ends in it."""
    ip("netns", "add", name)
    try:
        ip("-n", name, "link", "set", "lo", "up")
        yield
    finally:
        ip("netns", "del", name)


@dataclass(frozen=True, slots=True)
class End:
    """One end of a cable."""

    device: str
    address: str
    namespace: str = ""
    """Empty: where the test is."""

    @property
    def there(self) -> list[str]:
        """What `ip` is told of where it is."""
        return ["-n", self.namespace] if self.namespace else []

    def up(self) -> None:
        """Gives it its address, and plugs it in."""
        ip(*self.there, "addr", "add", f"{self.address}/24", "dev", self.device)
        self.plug()

    def plug(self) -> None:
        ip(*self.there, "link", "set", self.device, "up")

    def unplug(self) -> None:
        ip(*self.there, "link", "set", self.device, "down")


def lay_cable(here: End, there: End) -> None:
    """From one namespace to another, plugged in."""
    peer = ["peer", "name", there.device, *(["netns", there.namespace] if there.namespace else [])]
    ip(*here.there, "link", "add", here.device, "type", "veth", *peer)
    here.up()
    there.up()


class Network:
    """Hosts, each on a cable of its own to what routes between them; see :func:`hosts`."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._unique = f"armsight-{os.getpid()}-{secrets.token_hex(3)}"

    @property
    def middle(self) -> str:
        """The namespace that routes."""
        return self.namespace_of("network")

    def namespace_of(self, host: str) -> str:
        return f"{self._unique}-{host}"

    def address(self, host: str) -> str:
        return f"10.231.{self._number(host)}.2"

    def device(self, host: str) -> str:
        """Both ends of a host's cable are called so."""
        return f"cable{self._number(host)}"

    def _number(self, host: str) -> int:
        return 1 + self._names.index(host)

    @contextmanager
    def made(self) -> Iterator[None]:
        """The network for a while."""
        with ExitStack() as undo:
            undo.enter_context(namespace(self.middle))
            _run(*inside(self.middle), "sh", "-c", "echo 1 >/proc/sys/net/ipv4/ip_forward")
            for name in self._names:
                there = self.namespace_of(name)
                undo.enter_context(namespace(there))
                gateway = f"10.231.{self._number(name)}.1"
                lay_cable(
                    End(self.device(name), gateway, self.middle), End(self.device(name), self.address(name), there)
                )
                ip("-n", there, "route", "add", "default", "via", gateway)
            yield

    # faults

    @contextmanager
    def lossy(self, hosts: Sequence[str], share: float, way: Way = "both") -> Iterator[None]:
        """Packets are lost at random."""
        rule = ["-m", "statistic", "--mode", "random", "--probability", f"{share}", "-j", "DROP"]
        with self._short_packets(), self._rule(hosts, way, rule):
            yield

    @contextmanager
    def cut(self, hosts: Sequence[str], way: Way = "both") -> Iterator[None]:
        """Nothing arrives, and nobody is told."""
        with self._rule(hosts, way, ["-j", "DROP"]):
            yield

    @contextmanager
    def slow(self, hosts: Sequence[str], mbit_s: float) -> Iterator[None]:
        """Cables have a rate, in either direction; 10 Gbit/s after it."""
        cables = [(end, self.device(host)) for host in hosts for end in (self.middle, self.namespace_of(host))]
        done = []
        try:
            for end, device in cables:
                self._rate(end, device, f"{mbit_s:g}mbit", "16kb")
                done.append((end, device))
            yield
        finally:
            for end, device in done:  # not taken away: what it queues would be lost, which is another fault
                self._rate(end, device, "10gbit", "4mb")

    def _rate(self, end: str, device: str, rate: str, burst: str) -> None:
        bucket = ["tbf", "rate", rate, "burst", burst, "latency", f"{_QUEUED_MS}ms"]
        _run("tc", "-n", end, "qdisc", "replace", "dev", device, "root", *bucket)

    @contextmanager
    def held(
        self,
        hosts: Sequence[str],
        delay_ms: float,
        jitter_ms: float = 0.0,
        overtaking: float = 0.0,
        correlation: float = 0.0,
        seed: int = 0,
    ) -> Iterator[None]:
        """Packets come later, and out of order: see :class:`held_packets.Delays`; in either direction alike."""
        with ExitStack() as undo:
            undo.enter_context(self._short_packets())
            for host in hosts:
                queue = self._number(host)
                flags = {
                    "queue": queue,
                    "delay-ms": delay_ms,
                    "jitter-ms": jitter_ms,
                    "overtaking": overtaking,
                    "correlation": correlation,
                    "seed": seed,
                }
                command = [sys.executable, str(Path(__file__).with_name("held_packets.py"))]
                command += [f"--{name}={value}" for name, value in flags.items()]
                undo.enter_context(_running([*inside(self.middle), *command]))
                undo.enter_context(self._rule([host], "both", ["-j", "NFQUEUE", "--queue-num", str(queue)]))
            yield

    @contextmanager
    def _short_packets(self) -> Iterator[None]:
        """Hosts send what a cable carries at once, where they would leave it to the cable to cut 64 kB up."""
        done = []
        try:
            for name in self._names:
                self._most_segments(name, 1)
                done.append(name)
            yield
        finally:
            for name in done:
                self._most_segments(name, _SEGMENTS)

    def _most_segments(self, name: str, number: int) -> None:
        ip("-n", self.namespace_of(name), "link", "set", self.device(name), "gso_max_segs", str(number))

    @contextmanager
    def _rule(self, hosts: Sequence[str], way: Way, rule: Sequence[str]) -> Iterator[None]:
        """What Netfilter does with the packets that the network passes on."""
        sides = {"to": ("-o",), "from": ("-i",), "both": ("-o", "-i")}[way]
        rules = [["FORWARD", side, self.device(host), *rule] for host in hosts for side in sides]
        done = []
        try:
            for each in rules:
                self._iptables("-A", *each)
                done.append(each)
            yield
        finally:
            for each in done:
                self._iptables("-D", *each)

    def _iptables(self, *words: str) -> None:
        _run(*inside(self.middle), "iptables", "--wait", *words)


@contextmanager
def hosts(names: Sequence[str]) -> Iterator[Network]:
    """A host for each name, whose cables are well."""
    network = Network(names)
    with network.made():
        yield network


class SpreadStack(Stack):
    """Each process on a host of its own, which has its name."""

    def __init__(self, network: Network, **options: object) -> None:
        self._network = network
        super().__init__(**options)  # type: ignore[arg-type]

    @property
    def endpoint(self) -> str:
        return f"tcp/{self._network.address('router')}:{self.port}"

    def command(self, name: str) -> list[str]:
        return [*inside(self._network.namespace_of(name)), *super().command(name)]


def _run(*words: str) -> None:
    done = subprocess.run(words, capture_output=True, timeout=10, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(words)}: {done.stderr}"


@contextmanager
def _running(command: Sequence[str]) -> Iterator[None]:
    """A program that says a line when it is there, until SIGTERM."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline(), f"{' '.join(command)} ended at once"
        yield
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=5)
        assert process.returncode == 0
    finally:
        process.kill()
        process.communicate()
