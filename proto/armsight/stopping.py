"""How a process that goes on is ended: by SIGTERM as by Ctrl-C."""

import _thread
import logging
import signal
import threading

log = logging.getLogger(__name__)


def stop_on_signals() -> threading.Event:
    """An event that SIGTERM and Ctrl-C set from now on."""
    stop = threading.Event()

    def end(name: str) -> None:
        log.info("stopping", extra={"signal": name})
        stop.set()

    def ask_to_stop(signum: int, frame: object) -> None:
        del frame
        # Python handles a signal between any two instructions of its first thread. Inside stop.wait() that thread
        # holds the event's lock, which set() wants: by a thread of its own, begun without a lock, it waits its turn.
        _thread.start_new_thread(end, (signal.Signals(signum).name,))

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, ask_to_stop)
    return stop
