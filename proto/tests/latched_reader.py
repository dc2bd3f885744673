"""A process that prints the name of every description it hears; its reader is slow where it is stopped."""

import sys
import threading

from armsight import topics
from armsight.bus import open_bus
from armsight.session import SessionConfig, open_session

if __name__ == "__main__":
    session = open_session(SessionConfig(endpoints=(sys.argv[1],), shared_memory="off"), threading.Event())
    assert session is not None
    with open_bus(session) as bus:
        descriptions = bus.subscriber(topics.DESCRIPTION)
        while received := descriptions.recv():
            print(received.message.name.strip(), flush=True)
