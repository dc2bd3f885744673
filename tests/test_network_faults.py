"""Faults of the network at random moments while the arm tracks, with each service and the router on a host of its own.

The arm holds while it gets no fresh commands, goes on in time, and its recording, made beside the router, breaks no
promise.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

import network
import numpy as np
import pytest
from network import Network, SpreadStack

import faults
from rig import SERVICES, Rig

pytestmark = network.NEEDS_ROOT

SEED = 141421
TIMES_LONG = 50
AGAIN_S = 2.0
"""From the end of the fault until the arm moves."""

Do = Callable[[Network, Sequence[str], int], AbstractContextManager[None]]


@dataclass(frozen=True, slots=True)
class Harm:
    """What is done to the cables of some hosts, for how long."""

    kind: str
    victims: tuple[str, ...]
    seconds: float
    do: Do


def partition(way: network.Way) -> Do:
    return lambda net, victims, _: net.cut(victims, way)


def delayed(net: Network, victims: Sequence[str], seed: int) -> AbstractContextManager[None]:
    return net.held(victims, delay_ms=50, jitter_ms=20, seed=seed)


def reordered(net: Network, victims: Sequence[str], seed: int) -> AbstractContextManager[None]:
    return net.held(victims, delay_ms=10, overtaking=0.25, correlation=0.5, seed=seed)


def lossy(net: Network, victims: Sequence[str], _: int) -> AbstractContextManager[None]:
    return net.lossy(victims, share=0.1)


def slow(net: Network, victims: Sequence[str], _: int) -> AbstractContextManager[None]:
    return net.slow(victims, mbit_s=1)


IN_CI = {
    "delay": Harm("delay of 50 ms ± 20", SERVICES, 3.0, delayed),
    "loss": Harm("loss of 10 %", SERVICES, 3.0, lossy),
    "reordering": Harm("reordering", SERVICES, 3.0, reordered),
    "rate": Harm("1 Mbit/s", ("sim",), 4.0, slow),
    "partition of sim": Harm("partition for 5 s", ("sim",), 5.0, partition("both")),
    "partition of control": Harm("partition for 5 s", ("control",), 5.0, partition("both")),
    "nothing to vision": Harm("partition for 5 s, to it", ("vision",), 5.0, partition("to")),
}
ALL = {
    **IN_CI,
    "partition of vision": Harm("partition for 5 s", ("vision",), 5.0, partition("both")),
    **{f"nothing to {name}": Harm("partition for 5 s, to it", (name,), 5.0, partition("to")) for name in SERVICES},
    **{
        f"nothing from {name}": Harm("partition for 5 s, from it", (name,), 5.0, partition("from")) for name in SERVICES
    },
    "partition of control for longer": Harm("partition for 12 s", ("control",), 12.0, partition("both")),
}


@pytest.fixture(scope="module")
def spread(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Rig, Network]]:
    """The arm follows its target; the test and the recorder are with the router, by a socket in the file system."""
    out = tmp_path_factory.mktemp("spread")
    watch = f"unixsock-stream/{out / 'bus'}"
    with pytest.MonkeyPatch.context() as patch, network.hosts(("router", *SERVICES)) as net:
        patch.setenv("ARMSIGHT_SHARED_MEMORY", "off")  # hosts have none in common, namespaces do
        extra = {"router": ["--listen", watch, "--insecure-bind"]}  # in a namespace that nobody else is in
        rig = Rig(SpreadStack(net, out=out, fps=15, extra=extra), endpoint=watch)
        try:
            rig.start_all()
            yield rig, net
        finally:
            rig.close()


def suffered(rig: Rig, net: Network, harm: Harm, seed: int) -> faults.Fault:
    began_ns = time.time_ns()
    with harm.do(net, harm.victims, seed):
        rig.pause(harm.seconds)
    return faults.passed(rig, harm.kind, harm.victims, began_ns)


def run(spread: tuple[Rig, Network], path: Path, harm: Harm, times: int, seed: int) -> None:
    print(f"seed {seed}")
    rig, net = spread
    random = np.random.default_rng(seed)
    done = []
    rig.wait_ready()
    before = rig.instances()
    with faults.recording(rig, path):
        for _ in range(times):
            # setup: the arm moves, and all are well
            rig.wait_ready()
            rig.wait_until(rig.moving, 20, "the arm moves")
            rig.pause(float(random.uniform(0.3, 1.5)))
            # fault and recovery
            done.append(suffered(rig, net, harm, int(random.integers(2**31))))
        rig.wait_ready()
        rig.wait_until(rig.moving, 20, "the arm moves in the end")
    # invariants
    assert rig.instances() == before, "a service was started anew"
    recorded, recoveries = faults.judged(path, done)
    for fault in done:
        faults.assert_some_health_showed(recorded, fault)
    assert [each for each in recoveries if each.recovery_s > AGAIN_S] == [], f"seed {seed}"


@pytest.mark.parametrize("fault", IN_CI)
def test_arm_goes_on_in_time_after_the_network_was_bad(spread: tuple[Rig, Network], tmp_path: Path, fault: str) -> None:
    run(spread, tmp_path / "run.mcap", IN_CI[fault], 1, SEED + list(ALL).index(fault))


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("fault", ALL)
def test_nothing_breaks_however_often_the_network_is_bad(
    spread: tuple[Rig, Network], tmp_path: Path, fault: str
) -> None:
    run(spread, tmp_path / "run.mcap", ALL[fault], TIMES_LONG, SEED + 1000 + list(ALL).index(fault))
