"""What a process needs of its machine runs out while the arm tracks: it holds or goes on, nothing dies, it recovers."""

import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

import faults
from armsight_operator.stack import Stack
from rig import SERVICES, Rig, started

SECONDS = 5.0
AGAIN_S = 2.0
"""The arm moves by then, from the moment that what ran out is there again."""

ROOM_BYTES = 48 * 1024 * 1024
"""Of /dev/shm where it is the test's own."""

MAY_MOUNT = os.geteuid() == 0 and shutil.which("nsenter") is not None

needs_root = pytest.mark.skipif(
    not MAY_MOUNT and "ARMSIGHT_CI" not in os.environ, reason="has a /dev/shm of its own: needs root"
)


def suffer(rig: Rig, path: Path, lack: "Lack") -> None:
    """Setup, fault, recovery and invariants, once."""
    before = rig.instances()
    with faults.recording(rig, path):
        rig.wait_until(rig.moving, 20, "the arm moves")
        with lack:
            rig.pause(SECONDS)
        ended_ns = time.time_ns()
        rig.wait_until(lambda: rig.moved_since(ended_ns), AGAIN_S, "the arm moves again")
        rig.wait_ready()
    assert rig.instances() == before, "a service died of it"
    faults.assert_no_violation(faults.timeline(path))
