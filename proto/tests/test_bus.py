import gc
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from google.protobuf.empty_pb2 import Empty

from armsight import topics
from armsight.bus import Bus, open_bus
from armsight.errors import ArmsightError, NoReplyError, RefusedError, SessionClosedError
from armsight.images import encode_rgb8
from armsight.session import SessionConfig, open_session
from armsight.times import from_timestamp
from armsight.v1.control_pb2 import CONTROL_MODE_HOLD, SetModeRequest, SetModeResponse
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.joints_pb2 import JointPositions
from armsight.v1.safety_pb2 import StopState
from armsight.v1.sim_pb2 import Clock

Buses = tuple[Bus, Bus]


def eventually(condition: Callable[[], bool], timeout_s: float = 5.0) -> bool:
    deadline = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True


def has_match(declared: zenoh.Publisher | zenoh.Querier) -> bool:
    status: Any = declared.matching_status  # an object, though Zenoh's stubs say bool
    return bool(status.matching)


def test_message_arrives_decoded_with_its_key(two_buses: Buses) -> None:
    here, there = two_buses
    subscriber = there.subscriber(topics.CAMERA_IMAGE, "*")
    publisher = here.publisher(topics.CAMERA_IMAGE, "left")
    assert eventually(publisher.has_subscribers)
    pixels = np.random.default_rng(1).integers(0, 256, (12, 16, 3), dtype=np.uint8).tobytes()
    publisher.put_bytes(encode_rgb8(pixels, 16, 12, "camera_left_optical", 1_700_000_000_123_456_789))
    received = subscriber.recv(2.0)
    assert received is not None
    assert received.name == "left"
    assert received.message.data == pixels
    assert (received.message.width, received.message.height, received.message.step) == (16, 12, 48)
    assert from_timestamp(received.message.timestamp) == 1_700_000_000_123_456_789


def test_what_was_put_before_is_known_with_what_was_put_after(two_buses: Buses) -> None:
    here, there = two_buses
    newest, after = there.newest(topics.CLOCK), there.subscriber(topics.JOINT_POSITIONS)
    assert newest.get() is None
    clocks, positions = here.publisher(topics.CLOCK), here.publisher(topics.JOINT_POSITIONS)
    assert eventually(lambda: clocks.has_subscribers() and positions.has_subscribers())
    for second in range(1, 201):
        clock, joints = Clock(), JointPositions()
        clock.capture_time.seconds = joints.capture_time.seconds = second
        clocks.put(clock)
        positions.put(joints)
        received = after.recv(2.0)
        assert received is not None
        assert received.message.capture_time.seconds == second
        assert newest.get() == clock


def test_newest_is_what_could_be_decoded_and_the_rest_is_counted(two_buses: Buses) -> None:
    here, there = two_buses
    newest, clocks = there.newest(topics.CLOCK), here.publisher(topics.CLOCK)
    assert eventually(clocks.has_subscribers)
    clock = Clock()
    clock.capture_time.seconds = 7
    clocks.put(clock)
    clocks.put_bytes(b"\xff" * 7)
    assert eventually(lambda: newest.get() == clock and there.counters.snapshot() == {"malformed_clock": 1})
    there.session.close()  # type: ignore[no-untyped-call]
    assert newest.get() == clock


@pytest.mark.parametrize(
    "payload", [b"\xff" * 7, b"\x0a\xff\xff\xff\xff\x0f", bytes(range(256)) * 40], ids=["noise", "truncated", "long"]
)
def test_malformed_bytes_are_counted_and_the_next_message_still_arrives(two_buses: Buses, payload: bytes) -> None:
    here, there = two_buses
    subscriber = there.subscriber(topics.JOINT_POSITIONS)
    publisher = here.publisher(topics.JOINT_POSITIONS)
    assert eventually(publisher.has_subscribers)
    publisher.put_bytes(payload)
    assert eventually(lambda: there.counters.snapshot().get("malformed_joint_positions") == 1)
    publisher.put(JointPositions())
    assert subscriber.recv(2.0) is not None


def test_another_schema_on_a_key_is_refused_though_its_bytes_would_parse(two_buses: Buses) -> None:
    here, there = two_buses
    subscriber = there.subscriber(topics.STOP_STATE)
    publisher = here.session.declare_publisher("safety/stop", encoding="application/protobuf;armsight.v1.Clock")
    assert eventually(lambda: has_match(publisher))
    publisher.put(b"")
    assert eventually(lambda: there.counters.snapshot().get("malformed_stop_state") == 1)
    assert subscriber.latest is None


def test_publisher_knows_whether_anybody_listens(two_buses: Buses) -> None:
    here, there = two_buses
    publisher = here.publisher(topics.JOINT_POSITIONS)
    assert not publisher.has_subscribers()
    subscriber = there.subscriber(topics.JOINT_POSITIONS)
    assert eventually(publisher.has_subscribers)
    subscriber.close()
    assert eventually(lambda: not publisher.has_subscribers())


def test_late_subscriber_gets_the_last_latched_value_only(two_buses: Buses) -> None:
    here, there = two_buses
    publisher = here.publisher(topics.STOP_STATE)
    # Both values must have crossed the router before the late one joins: it would rightly get one still on its way.
    witness = there.subscriber(topics.STOP_STATE)
    publisher.put(StopState(stopped=True))
    publisher.put(StopState(stopped=False))
    assert eventually(lambda: witness.latest is not None and not witness.latest.message.stopped)
    witness.close()
    subscriber = there.subscriber(topics.STOP_STATE)
    received = subscriber.recv(2.0)
    assert received is not None
    assert not received.message.stopped
    assert subscriber.recv(0.2) is None


def test_latched_value_of_a_publisher_that_comes_later_arrives(two_buses: Buses) -> None:
    here, there = two_buses
    subscriber = there.subscriber(topics.STOP_STATE)
    for stopped in (True, False, True):
        publisher = here.publisher(topics.STOP_STATE)
        publisher.put(StopState(stopped=stopped))
        received = subscriber.recv(2.0)
        assert received is not None
        assert received.message.stopped == stopped


def test_last_of_many_latched_values_reaches_who_stood_still_meanwhile(endpoint: str, two_buses: Buses) -> None:
    publisher = two_buses[0].publisher(topics.DESCRIPTION)
    publisher.put(ArmDescription(name="first"))
    command = [sys.executable, str(Path(__file__).with_name("latched_reader.py")), endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        heard: list[str] = []
        assert process.stdout is not None
        reading = threading.Thread(target=lambda lines: heard.extend(map(str.strip, lines)), args=[process.stdout])
        reading.start()
        try:
            assert eventually(lambda: heard == ["first"], 20)
            process.send_signal(signal.SIGSTOP)
            # more than the buffers on the way hold: what comes last is thrown away
            for _ in range(400):
                publisher.put(ArmDescription(name="later".ljust(60_000)))
            publisher.put(ArmDescription(name="last".ljust(60_000)))
            time.sleep(0.5)
            process.send_signal(signal.SIGCONT)
            assert eventually(lambda: "last" in heard, 10), f"heard {len(heard)}, the last {heard[-1]}"
        finally:
            process.kill()
            reading.join()


def test_subscriber_keeps_the_newest_and_counts_what_it_lost(two_buses: Buses) -> None:
    here, there = two_buses
    subscriber = there.subscriber(topics.JOINT_POSITIONS, keep=2)
    publisher = here.publisher(topics.JOINT_POSITIONS)
    assert eventually(publisher.has_subscribers)
    for seconds in range(5):
        message = JointPositions()
        message.capture_time.seconds = seconds
        publisher.put(message)
        assert eventually(
            lambda seconds=seconds: (  # type: ignore[misc]
                subscriber.latest is not None and subscriber.latest.message.capture_time.seconds == seconds
            )
        )
    assert subscriber.lost == 3
    kept = [subscriber.recv(0.1), subscriber.recv(0.1), subscriber.recv(0.1)]
    assert [k.message.capture_time.seconds if k else None for k in kept] == [3, 4, None]


def test_failing_handler_does_not_end_the_subscription(two_buses: Buses) -> None:
    here, there = two_buses
    seen: list[int] = []

    def handle(received: object) -> None:
        seen.append(1)
        raise RuntimeError(f"on purpose: {received!r:.20}")

    there.subscriber(topics.JOINT_POSITIONS, on_message=handle)
    publisher = here.publisher(topics.JOINT_POSITIONS)
    assert eventually(publisher.has_subscribers)
    for count in (1, 2):
        publisher.put(JointPositions())
        assert eventually(lambda count=count: len(seen) == count)  # type: ignore[misc]
    assert there.counters.snapshot()["failed_joint_positions"] == 2


def test_query_is_answered_refused_or_unanswered_with_a_reason(two_buses: Buses) -> None:
    here, there = two_buses
    with pytest.raises(NoReplyError, match="is control running"):
        there.query(topics.MODE, SetModeRequest(), timeout_s=0.5)

    def answer(request: SetModeRequest) -> SetModeResponse:
        if request.start_s < 0:
            raise ArmsightError("start_s must not be negative")
        if request.start_s > 1e6:
            raise ZeroDivisionError("a fault in the service")
        return SetModeResponse(mode=request.mode)

    here.serve(topics.MODE, answer)
    querier = there.session.declare_querier("control/mode")
    assert eventually(lambda: has_match(querier))
    assert there.query(topics.MODE, SetModeRequest(mode=CONTROL_MODE_HOLD)).mode == CONTROL_MODE_HOLD
    with pytest.raises(RefusedError, match="must not be negative"):
        there.query(topics.MODE, SetModeRequest(start_s=-1))
    with pytest.raises(RefusedError, match="internal error: a fault in the service"):
        there.query(topics.MODE, SetModeRequest(start_s=1e9))
    malformed = list(there.session.get("control/mode", payload=b"\xff\xff"))
    assert "not a armsight.v1.SetModeRequest" in malformed[0].err.payload.to_string()  # type: ignore[union-attr]
    totals = here.counters.snapshot()
    assert (totals["refused_mode"], totals["failed_mode"], totals["malformed_mode"]) == (1, 1, 1)
    with pytest.raises(NoReplyError):
        there.query(topics.ASK_PARAMETERS, Empty(), "nobody", timeout_s=0.5)


def test_presence_tells_who_comes_and_goes(two_buses: Buses) -> None:
    here, there = two_buses
    changes: list[tuple[str, bool]] = []
    presence = there.presence(lambda name, here: changes.append((name, here)))
    token = here.session.liveliness().declare_token(topics.HEALTH.key_for("vision"))
    assert eventually(lambda: presence.alive() == {"vision"})
    token.undeclare()  # type: ignore[no-untyped-call]
    assert eventually(lambda: presence.alive() == frozenset())
    assert changes == [("vision", True), ("vision", False)]


def test_robots_on_one_router_do_not_hear_each_other(router: zenoh.Session, endpoint: str) -> None:
    del router
    sessions = [
        open_session(SessionConfig(endpoints=(endpoint,), namespace=name, shared_memory="off"), threading.Event())
        for name in ("robots/a", "robots/b")
    ]
    assert sessions[0] is not None
    assert sessions[1] is not None
    with open_bus(sessions[0]) as a, open_bus(sessions[1]) as b:
        heard_a, heard_b = a.subscriber(topics.STOP_STATE), b.subscriber(topics.STOP_STATE)
        a.publisher(topics.STOP_STATE).put(StopState(stopped=True))
        assert heard_a.recv(2.0) is not None
        assert heard_b.recv(0.3) is None


def test_waiting_on_a_session_that_closes_ends_at_once(router: zenoh.Session, endpoint: str) -> None:
    del router
    session = open_session(SessionConfig(endpoints=(endpoint,), shared_memory="off"), threading.Event())
    assert session is not None
    subscriber = Bus(session).subscriber(topics.CLOCK)
    threading.Timer(0.2, session.close).start()
    started = time.monotonic()
    with pytest.raises(SessionClosedError):
        subscriber.recv(10.0)
    assert time.monotonic() - started < 2.0


def test_latched_value_outlives_the_handle_that_put_it(two_buses: Buses) -> None:
    sender, receiver = two_buses
    sender.publisher(topics.STOP_STATE).put(StopState(stopped=True))
    gc.collect()
    late = receiver.subscriber(topics.STOP_STATE)
    received = late.recv(5.0)
    assert received is not None
    assert received.message.stopped


@pytest.mark.parametrize("topic", [topics.CLOCK, topics.STOP_STATE], ids=["plain", "latched"])
def test_subscriber_closes_while_it_waits(two_buses: Buses, topic: topics.Topic[Any]) -> None:
    subscriber = two_buses[1].subscriber(topic)
    subscriber.close()
    assert not subscriber.thread.is_alive()
    with pytest.raises(SessionClosedError):
        subscriber.recv(1.0)
