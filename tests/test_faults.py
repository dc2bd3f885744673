"""Faults of processes at random moments while the arm tracks: it recovers in time, its recording breaks no promise."""

import signal
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

import faults
from rig import SERVICES, Rig

SEED = 161803
FROZEN_S, FROZEN_LONG_S = 3.0, 15.0
TIMES_LONG = 50

# From the moment that what was started again says it is well; and that what was frozen, or the network, goes on.
RESTARTED_S, FROZEN_NO_MORE_S = 1.0, 2.0

Do = Callable[[Rig, Sequence[str]], faults.Fault]
VICTIMS = {**{name: (name,) for name in faults.ALL}, "all": faults.ALL}


def killed(rig: Rig, victims: Sequence[str]) -> faults.Fault:
    return faults.kill(rig, victims, signal.SIGKILL)


def ended(rig: Rig, victims: Sequence[str]) -> faults.Fault:
    return faults.kill(rig, victims, signal.SIGTERM)


def frozen(rig: Rig, victims: Sequence[str]) -> faults.Fault:
    return faults.freeze(rig, victims, FROZEN_S)


def frozen_long(rig: Rig, victims: Sequence[str]) -> faults.Fault:
    return faults.freeze(rig, victims, FROZEN_LONG_S)


def bar_s(fault: faults.Fault) -> float:
    """The router's absence is the network's."""
    frozen_or_network = fault.kind == "SIGSTOP" or fault.victims == ("router",)
    return FROZEN_NO_MORE_S if frozen_or_network else RESTARTED_S


def run(rig: Rig, path: Path, plan: Sequence[tuple[Do, Sequence[str]]], seed: int) -> None:
    print(f"seed {seed}")
    random = np.random.default_rng(seed)
    done = []
    with faults.recording(rig, path):
        for do, victims in plan:
            # setup: the arm moves, and all are well
            rig.wait_ready()
            rig.wait_until(rig.moving, 20, "the arm moves")
            rig.pause(float(random.uniform(0.3, 1.5)))
            # fault and recovery
            done.append(do(rig, victims))
        rig.wait_ready()
        rig.wait_until(rig.moving, 20, "the arm moves in the end")
    # invariants
    recorded, recoveries = faults.judged(path, done)
    for fault in done:
        faults.assert_health_showed(recorded, fault)
    late = [each for each, fault in zip(recoveries, done, strict=True) if each.recovery_s > bar_s(fault)]
    assert late == [], f"seed {seed}"


def test_arm_moves_again_in_time_after_each_process_was_killed(tracking: Rig, tmp_path: Path) -> None:
    run(tracking, tmp_path / "run.mcap", [(killed, victims) for victims in VICTIMS.values()], SEED)


def test_arm_moves_again_in_time_after_a_service_was_asked_to_end(tracking: Rig, tmp_path: Path) -> None:
    run(tracking, tmp_path / "run.mcap", [(ended, (name,)) for name in SERVICES], SEED + 1)


def test_arm_moves_again_in_time_after_each_process_stood_still(tracking: Rig, tmp_path: Path) -> None:
    run(tracking, tmp_path / "run.mcap", [(frozen, victims) for victims in VICTIMS.values()], SEED + 2)


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("victim", VICTIMS)
@pytest.mark.parametrize("do", [killed, ended, frozen_long], ids=["SIGKILL", "SIGTERM", "SIGSTOP"])
def test_nothing_breaks_however_often_it_happens(tracking: Rig, tmp_path: Path, do: Do, victim: str) -> None:
    seed = SEED + 1000 + list(VICTIMS).index(victim)
    run(tracking, tmp_path / "run.mcap", [(do, VICTIMS[victim])] * TIMES_LONG, seed)
