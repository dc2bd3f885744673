"""The bridge to Foxglove and Lichtblick, spoken to as they do."""

import base64
import json
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest
import websockets.sync.client
from foxglove_schemas_protobuf.Point3InFrame_pb2 import Point3InFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf import descriptor_pb2, descriptor_pool

from armsight import topics
from armsight.bus import Bus
from armsight.images import encode_rgb8
from armsight.parameters import Tunable, Value
from armsight.service import serve_parameters
from armsight.times import from_timestamp
from armsight.v1.joints_pb2 import MARKER_STATUS_TRACKED, JointPositions
from armsight.v1.parameters_pb2 import ParametersResponse
from armsight_operator.bridge.demand import Demand
from armsight_operator.bridge.foxglove_server import Bridge
from armsight_operator.bridge.parameters import flattened
from armsight_operator.bridge.target import TargetError, target_of
from armsight_operator.errors import PortInUseError
from fake_arm import description

WAIT_S = 10.0
_MESSAGE = struct.Struct("<BIQ")
_PUBLISH = struct.Struct("<BI")


def wait_until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.01)


class Viewer:
    """As much of a Foxglove as is needed."""

    def __init__(self, port: int) -> None:
        self._open = ExitStack()
        protocol = websockets.Subprotocol("foxglove.sdk.v1")
        self._socket = self._open.enter_context(
            websockets.sync.client.connect(f"ws://127.0.0.1:{port}", subprotocols=[protocol], max_size=None)
        )
        self.channels: dict[str, dict[str, Any]] = {}
        self.said: list[dict[str, Any]] = []
        self.received: list[tuple[int, bytes]] = []

    def listen(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            try:
                told = self._socket.recv(timeout=left)
            except TimeoutError:
                return
            if isinstance(told, bytes):
                _, subscription, _ = _MESSAGE.unpack_from(told)
                self.received.append((subscription, told[_MESSAGE.size :]))
                continue
            message = json.loads(told)
            self.said.append(message)
            for channel in message.get("channels", []) if message["op"] == "advertise" else []:
                self.channels[channel["topic"]] = channel

    def wait_for(self, condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + WAIT_S
        while not condition():
            assert time.monotonic() < deadline, f"{what}; {self.said}"
            self.listen(0.05)

    def subscribe(self, topic: str, number: int) -> None:
        self.wait_for(lambda: topic in self.channels, f"{topic} is offered")
        channel = self.channels[topic]["id"]
        self.send({"op": "subscribe", "subscriptions": [{"id": number, "channelId": channel}]})

    def unsubscribe(self, number: int) -> None:
        self.send({"op": "unsubscribe", "subscriptionIds": [number]})

    def publish(self, topic: str, payload: bytes, encoding: str = "json", number: int = 1) -> None:
        channel = {"id": number, "topic": topic, "encoding": encoding, "schemaName": "foxglove.Point3InFrame"}
        self.send({"op": "advertise", "channels": [channel]})
        self._socket.send(_PUBLISH.pack(1, number) + payload)

    def send(self, message: dict[str, Any]) -> None:
        self._socket.send(json.dumps(message))

    def close(self) -> None:
        self._open.close()


@pytest.fixture
def bridge(make_bus: Callable[[], Bus]) -> Iterator[Bridge]:
    bridge = Bridge(make_bus(), "127.0.0.1", 0, writable=True)
    yield bridge
    bridge.close()


@pytest.fixture
def viewer(bridge: Bridge) -> Iterator[Viewer]:
    viewer = Viewer(bridge.port)
    yield viewer
    viewer.close()


@pytest.fixture
def sim(make_bus: Callable[[], Bus]) -> Bus:
    """Somebody who described the arm."""
    bus = make_bus()
    bus.publisher(topics.DESCRIPTION).put(description())
    return bus


def test_every_key_is_offered_with_its_whole_schema(viewer: Viewer, sim: Bus) -> None:
    del sim
    expected = {topic.key for topic in topics.TOPICS if "{name}" not in topic.key}
    expected |= {f"camera/{n}/{what}" for n in "12" for what in ("image", "calibration", "pose", "annotations")}
    expected |= {f"health/{name}" for name in topics.EACH}
    viewer.wait_for(lambda: expected <= set(viewer.channels), "every key is offered")
    assert {key for key in viewer.channels if key not in expected} == {
        "converted/transforms",
        "converted/arm",
        "converted/markers",
    }
    for channel in viewer.channels.values():
        assert (channel["encoding"], channel["schemaEncoding"]) == ("protobuf", "protobuf")
        pool = descriptor_pool.DescriptorPool()
        for described in descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"])).file:
            pool.Add(described)
        assert pool.FindMessageTypeByName(channel["schemaName"])


def test_pictures_cost_nothing_while_nobody_looks(viewer: Viewer, sim: Bus) -> None:
    images = {name: sim.publisher(topics.CAMERA_IMAGE, name) for name in ("1", "2")}
    viewer.wait_for(lambda: "camera/1/image" in viewer.channels, "frames are offered")
    time.sleep(0.3)
    assert not images["1"].has_subscribers()
    viewer.subscribe("camera/1/image", 7)
    wait_until(images["1"].has_subscribers, "the bridge listens")
    assert not images["2"].has_subscribers()
    picture = encode_rgb8(bytes(48), 4, 4, "camera_1_optical", 5)
    images["1"].put_bytes(picture)
    viewer.wait_for(lambda: bool(viewer.received), "the picture comes")
    assert viewer.received == [(7, picture)]
    viewer.unsubscribe(7)
    wait_until(lambda: not images["1"].has_subscribers(), "the bridge listens no more")
    viewer.subscribe("camera/1/image", 8)
    wait_until(images["1"].has_subscribers, "the bridge listens again")
    viewer.close()
    wait_until(lambda: not images["1"].has_subscribers(), "nobody is there any more")


def test_who_comes_later_gets_what_is_latched(bridge: Bridge, viewer: Viewer, sim: Bus) -> None:
    del sim
    viewer.subscribe("description", 1)
    viewer.subscribe("converted/arm", 2)
    viewer.wait_for(lambda: {1, 2} <= {number for number, _ in viewer.received}, "description and links come")
    assert (1, description().SerializeToString()) in viewer.received
    second = Viewer(bridge.port)
    try:
        second.subscribe("description", 3)
        second.wait_for(lambda: bool(second.received), "the second gets it as well")
    finally:
        second.close()


def test_markers_are_drawn_for_who_looks_at_them(viewer: Viewer, sim: Bus) -> None:
    positions = sim.publisher(topics.JOINT_POSITIONS)
    viewer.subscribe("converted/markers", 4)
    wait_until(positions.has_subscribers, "the bridge listens to what they are made of")
    message = JointPositions()
    marker = message.markers.add(name="red", status=MARKER_STATUS_TRACKED)
    marker.position.z = 5.0
    positions.put(message)
    viewer.wait_for(lambda: bool(viewer.received), "a scene comes")
    (entity,) = SceneUpdate.FromString(viewer.received[0][1]).entities
    assert entity.spheres[0].pose.position.z == 5.0


def test_a_viewer_sets_the_target(viewer: Viewer, sim: Bus) -> None:
    heard: list[Point3InFrame] = []
    sim.subscriber(topics.TARGET, on_message=lambda received: heard.append(received.message))
    time.sleep(0.3)  # for the bridge's publisher to hear of it
    viewer.publish("/target", json.dumps({"frame_id": "base", "point": {"x": 3, "y": 1.5, "z": 7}}).encode())
    wait_until(lambda: len(heard) == 1, "the target is on the bus")
    assert (heard[0].frame_id, heard[0].point.y) == ("base", 1.5)
    assert abs(time.time_ns() - from_timestamp(heard[0].timestamp)) < 60e9


@pytest.mark.parametrize(
    ("topic", "payload", "said"),
    [
        ("joints/command", b"{}", "nothing but target can be published here"),
        ("target", b"{", "not a target such as"),
        ("target", b'{"frame_id": "moon", "point": {"x": 1}}', "base or world"),
    ],
)
def test_what_a_viewer_may_not_say_goes_nowhere_and_it_is_told(
    viewer: Viewer, sim: Bus, topic: str, payload: bytes, said: str
) -> None:
    heard: list[object] = []
    sim.subscriber(topics.TARGET, on_message=heard.append)
    sim.subscriber(topics.JOINT_COMMAND, on_message=heard.append)
    time.sleep(0.3)
    viewer.publish(topic, payload)
    viewer.wait_for(
        lambda: any(m["op"] == "status" and said in m["message"] for m in viewer.said), "the viewer is told why"
    )
    assert not heard


def test_read_only_bridge_takes_nothing(make_bus: Callable[[], Bus]) -> None:
    bridge = Bridge(make_bus(), "127.0.0.1", 0, writable=False)
    viewer = Viewer(bridge.port)
    try:
        viewer.wait_for(lambda: bool(viewer.said), "the server says what it can")
        assert "clientPublish" not in viewer.said[0]["capabilities"]
    finally:
        viewer.close()
        bridge.close()


def test_parameters_are_those_that_services_tell(viewer: Viewer, sim: Bus) -> None:
    sim.serve(topics.ASK_PARAMETERS, lambda _: ParametersResponse(json='{"fps": 30, "size": {"width": 800}}'), "sim")
    time.sleep(0.3)
    viewer.send({"op": "getParameters", "parameterNames": [], "id": "all"})
    viewer.wait_for(lambda: any(m["op"] == "parameterValues" for m in viewer.said), "parameters come")
    told = next(m for m in viewer.said if m["op"] == "parameterValues")
    assert {p["name"]: p["value"] for p in told["parameters"]} == {"sim.fps": 30, "sim.size.width": 800}


def test_parameters_are_set_from_a_viewer_and_a_refusal_is_told(viewer: Viewer, sim: Bus) -> None:
    tunables = serve_parameters("sim", sim, {"fps": 30})
    applied: list[dict[str, Value]] = []
    tunables.declare(
        (Tunable("samples", "of a pixel", 0, "", 0, 4), Tunable("noise", "of pictures", 0.0, "", 0.0, 50.0)),
        lambda values: applied.append(dict(values)),
    )
    time.sleep(0.3)

    def set_to(ident: str, *parameters: dict[str, object]) -> dict[str, object]:
        viewer.send({"op": "setParameters", "parameters": list(parameters), "id": ident})
        viewer.wait_for(lambda: any(m.get("id") == ident for m in viewer.said), "what is in force comes back")
        told = next(m for m in viewer.said if m.get("id") == ident)
        return {p["name"]: p["value"] for p in told["parameters"]}

    both = set_to("both", {"name": "sim.samples", "value": 4}, {"name": "sim.noise", "value": 2})
    assert both == {"sim.samples": 4, "sim.noise": 2}
    assert applied == [{"samples": 4, "noise": 2.0}]
    assert set_to("refused", {"name": "sim.noise", "value": 99.0}) == {"sim.noise": 2}
    viewer.wait_for(
        lambda: any("within 0 to 50, not 99" in str(m.get("message")) for m in viewer.said), "the reason is told"
    )
    assert len(applied) == 1


def test_a_port_that_is_taken_is_said(bridge: Bridge, make_bus: Callable[[], Bus]) -> None:
    with pytest.raises(PortInUseError, match="choose another with --port"):
        Bridge(make_bus(), "127.0.0.1", bridge.port, writable=True)


def test_the_command_serves_until_it_is_asked_to_stop(endpoint: str) -> None:
    code = "from armsight_operator.cli.app import main; main()"
    command = [sys.executable, "-c", code, "bridge", "foxglove", "--port", "0", "--connect", endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("Foxglove and Lichtblick connect to ws://127.0.0.1:")
        viewer = Viewer(int(line.rpartition(":")[2]))
        viewer.subscribe("clock", 1)
        began = time.monotonic()
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=20)
        assert time.monotonic() - began < 4.0
        viewer.close()
    assert (process.returncode, err) == (0, "")


# its parts


NO_TARGETS = (
    *(b"", b"[]", b"1", b"null", b'{"point": 1}', b'{"header": 1, "point": {}}', b'{"point": {"x": "a"}}', b"\xff"),
    *(b'{"frame_id": "base"}', b'{"frame_id": "base", "point": {"x": "NaN"}}', b"[" * 100_000),
)


@pytest.mark.parametrize("payload", NO_TARGETS)
def test_what_is_no_target_is_refused(payload: bytes) -> None:
    with pytest.raises(TargetError):
        target_of("json", payload)


def test_targets_come_in_three_shapes() -> None:
    whole = Point3InFrame(frame_id="world")
    whole.point.x = 2.0
    clicked = b'{"header": {"frame_id": "world", "stamp": {"sec": 1}}, "point": {"x": 2, "y": 0, "z": 0}}'
    for encoding, payload in (
        ("protobuf", whole.SerializeToString()),
        ("json", b'{"frame_id": "world", "point": {"x": 2}}'),
        ("json", clicked),
    ):
        found = target_of(encoding, payload)
        assert (found.frame_id, found.point.x, found.point.z) == ("world", 2.0, 0.0)
    with pytest.raises(TargetError, match="json or protobuf"):
        target_of("cdr", b"")


def test_parameters_are_flat_and_plain() -> None:
    assert flattened('{"a": {"b": 1, "c": [1, 2]}, "d": null, "e": true}') == {
        "a.b": 1,
        "a.c": "[1, 2]",
        "d": "null",
        "e": True,
    }
    assert flattened("no json") == {}


def test_demand_listens_once_however_many_look() -> None:
    begun: list[str] = []
    ended: list[str] = []

    def begin(key: str) -> Callable[[], None]:
        begun.append(key)
        return lambda: ended.append(key)

    demand = Demand(begin)
    for _ in range(3):
        demand.add("a")
    wait_until(lambda: begun == ["a"], "it listens")
    demand.remove("a")
    demand.remove("a")
    time.sleep(0.1)
    assert ended == []
    demand.remove("a")
    wait_until(lambda: ended == ["a"], "the last one left")
    demand.add("b")
    wait_until(lambda: begun == ["a", "b"], "it listens")
    demand.close()
    assert ended == ["a", "b"]
