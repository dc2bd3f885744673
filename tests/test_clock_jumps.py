"""The wall clock of a process jumps by an hour, forward and back, while the arm tracks: nobody goes by it."""

import time
from pathlib import Path

import faults
from armsight_operator.stack import Stack
from rig import SERVICES, Rig, started

LIBRARY = next(Path("/usr/lib").glob("*/faketime/libfaketime.so.1"), None)
JUMPS = ("+3600s", "+0s", "-3600s", "+0s")
SECONDS = 0.7
AGAIN_S = 2.0


class Jumping(Stack):
    """Every process asks libfaketime for the wall clock, which goes by a file of its own; monotonic clocks stay."""

    def __init__(self, out: Path) -> None:
        self._folder = out
        super().__init__(out=out)
        for name in self.names:
            self.jump(name, "+0s")

    def jump(self, name: str, by: str) -> None:
        (self._folder / f"{name}.clock").write_text(f"{by}\n", encoding="ascii")

    def command(self, name: str) -> list[str]:
        variables = {
            "LD_PRELOAD": str(LIBRARY),
            "FAKETIME_TIMESTAMP_FILE": str(self._folder / f"{name}.clock"),
            "FAKETIME_NO_CACHE": "1",
            "FAKETIME_DONT_FAKE_MONOTONIC": "1",
        }
        return ["env", *(f"{key}={value}" for key, value in variables.items()), *super().command(name)]


def clock_of(rig: Rig, name: str) -> int:
    return rig.health(name).now.seconds


def test_jumps_of_a_wall_clock_move_nothing_and_stop_nothing(tmp_path: Path) -> None:
    assert LIBRARY is not None, "libfaketime is missing: tools/install-apt-packages.sh installs it"
    stack = Jumping(tmp_path)
    path = tmp_path / "run.mcap"
    with started(stack) as rig, faults.recording(rig, path):
        before = rig.instances()
        for name in ("router", *SERVICES):
            for by in JUMPS:
                rig.wait_until(rig.moving, 20, "the arm moves")
                stack.jump(name, by)
                jumped_ns = time.time_ns()
                if name != "router":
                    away_s = int(by.removesuffix("s"))
                    rig.wait_until(
                        lambda name=name, away_s=away_s: abs(clock_of(rig, name) - time.time() - away_s) < 5,  # type: ignore[misc]
                        5,
                        f"{name}'s clock jumped",
                    )
                rig.pause(SECONDS)
                rig.wait_until(lambda since=jumped_ns: rig.moved_since(since), AGAIN_S, f"{name} jumped by {by}")  # type: ignore[misc]
        assert rig.instances() == before
    faults.assert_no_violation(faults.timeline(path))
