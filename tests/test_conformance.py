"""Our own services fulfil the contract, by the suite that others are judged with."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from rig import Rig

SMALL = {"sim": ["--width", "320", "--height", "240"]}
"""Frames that are drawn and read in time on a busy machine, too."""


def conformance(rig: Rig, service: str, *flags: str) -> subprocess.CompletedProcess[str]:
    command = [str(Path(sys.executable).with_name("armsight")), "conformance", service, *flags]
    where = ["--connect", rig.stack.endpoint, "--namespace", rig.stack.namespace]
    return subprocess.run([*command, *where], capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.parametrize(
    ("service", "options"),
    [
        ("vision", {}),
        ("control", {"extra": {"control": ["--solver", "closed-form"]}}),
        ("sim", {"clock": "lockstep", "extra": SMALL}),
        ("sim", {"clock": "realtime", "extra": SMALL}),
    ],
    ids=["vision", "control", "sim-lockstep", "sim-realtime"],
)
def test_our_own_services_fulfil_the_contract(
    make_rig: Callable[..., Rig], service: str, options: dict[str, object]
) -> None:
    rig = make_rig(**{"target": "none", "mode": "hold"} | options)
    rig.start("router")
    rig.start(service)
    rig.wait_until(lambda: bool(rig.bus) and rig.heard_of(service), 30, f"{service} is there")
    done = conformance(rig, service, "--json")
    assert done.stdout, done.stderr
    found = json.loads(done.stdout)
    assert [check for check in found["checks"] if check["outcome"] == "failed"] == []
    assert found["ok"]
    assert done.returncode == 0
    assert len(found["checks"]) > 10
