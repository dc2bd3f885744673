"""A signal ends what waits for it, whatever instruction it interrupts."""

import signal
import subprocess
import sys

import pytest

# most of the time inside wait(), where the event's lock is held now and then
WAITING = (
    "from armsight.stopping import stop_on_signals\n"
    "stop = stop_on_signals()\n"
    "print('waits', flush=True)\n"
    "while not stop.wait(0):\n"
    "    pass\n"
)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signal_ends_it_at_any_moment(number: signal.Signals) -> None:
    for _ in range(10):
        with subprocess.Popen([sys.executable, "-c", WAITING], stdout=subprocess.PIPE, text=True) as process:
            try:
                assert process.stdout is not None
                assert process.stdout.readline() == "waits\n"
                process.send_signal(number)
                assert process.wait(2.0) == 0
            finally:
                process.kill()
