"""The bus over Foxglove's WebSocket protocol: Foxglove and Lichtblick look at it live.

Messages pass as they are. A key is only listened to while somebody looks at its channel: pictures that nobody looks at
cost nothing. `description` alone is always listened to, for it names the cameras.
"""

import logging
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

import foxglove
from foxglove.websocket import Capability, ChannelView, Client, ClientChannel
from google.protobuf.empty_pb2 import Empty
from google.protobuf.message import DecodeError, Message

from armsight.bus import Bus, Received, Sample
from armsight.errors import ArmsightError
from armsight.schema import descriptor_set
from armsight.topics import (
    ASK_PARAMETERS,
    DESCRIPTION,
    EACH,
    NAME,
    SERVICES,
    SET_PARAMETERS,
    TARGET,
    TOPICS,
    Topic,
    encoding_of,
)
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.parameters_pb2 import ParametersResponse, SetParametersRequest
from armsight_operator.bridge.demand import Demand
from armsight_operator.bridge.parameters import flattened, given, in_force
from armsight_operator.bridge.target import TargetError, target_of
from armsight_operator.errors import PortInUseError
from armsight_operator.recording.scene import MESSAGES, SOURCES, Scene

log = logging.getLogger(__name__)

_BACKLOG = 64
"""Messages that may wait for one slow viewer; then the oldest are dropped."""
_PARAMETERS_S = 0.5


class Bridge:
    """One server, and a place on the bus."""

    def __init__(self, bus: Bus, host: str, port: int, *, writable: bool) -> None:
        """Listens from now on.

        Args:
            bus: a session of the bridge's own.
            host: address to listen at.
            port: 0 takes a free one.
            writable: whether viewers may publish `target` and set parameters.

        Raises:
            PortInUseError: it can't listen there.
        """
        self._bus = bus
        self._context = foxglove.Context()
        self._lock = threading.RLock()
        self._channels: dict[str, foxglove.Channel] = {}
        self._topics: dict[str, tuple[Topic[Any], str]] = {}
        self._latched: dict[str, bytes] = {}
        self._scene = Scene()
        self._targets = bus.publisher(TARGET) if writable else None
        self._demand = Demand(self._listen)
        for channel, message in MESSAGES.items():
            self._advertise(channel, message, {"converted_from": SOURCES[channel]})
        for topic in TOPICS:
            if "{name}" not in topic.key:
                self._offer(topic, "")
            elif topic.key.startswith("health/"):
                for name in EACH:
                    self._offer(topic, name)
        capabilities = [Capability.Parameters, *([Capability.ClientPublish] if writable else [])]
        try:
            self._server = foxglove.start_server(
                name="armsight",
                host=host,
                port=port,
                capabilities=capabilities,
                supported_encodings=["json", "protobuf"],
                server_listener=_Listener(self),
                context=self._context,
                message_backlog_size=_BACKLOG,
            )
        except Exception as error:  # of a class that only its Rust side knows
            self._demand.close()
            raise PortInUseError(f"can't listen at {host}:{port} ({error}): choose another with --port") from error
        bus.subscriber(DESCRIPTION, on_message=self._described)

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._server.port)

    def close(self) -> None:
        """Ends the server and listens to nothing any more."""
        self._server.stop()
        self._demand.close()

    # what there is

    def _offer(self, topic: Topic[Any], name: str) -> None:
        key = topic.key_for(name or None)
        with self._lock:
            if key in self._topics:
                return
            self._topics[key] = (topic, name)
            self._advertise(key, topic.message, {"encoding": encoding_of(topic.message)})

    def _advertise(self, key: str, message: type[Message], metadata: dict[str, str]) -> None:
        data = descriptor_set([message]).SerializeToString()
        schema = foxglove.Schema(name=message.DESCRIPTOR.full_name, encoding="protobuf", data=data)
        self._channels[key] = foxglove.Channel(
            key, schema=schema, message_encoding="protobuf", context=self._context, metadata=metadata
        )

    def _described(self, received: Received[ArmDescription]) -> None:
        with self._lock:
            converted = self._scene.convert(DESCRIPTION, received.message)
        if converted is not None:
            self._latched[converted.channel] = converted.message.SerializeToString()
            self._say(converted.channel, self._latched[converted.channel])
        names = [camera for camera in received.message.cameras if NAME.fullmatch(camera)]
        for topic in TOPICS:
            if topic.key.startswith("camera/"):
                for camera in names:
                    self._offer(topic, camera)

    # what is looked at

    def looked_at(self, key: str) -> None:
        """A viewer opened a channel."""
        self._demand.add(SOURCES.get(key, key))
        # who comes later gets what is latched, too; who has it gets it once more
        if (last := self._latched.get(key)) is not None:
            self._say(key, last)

    def left(self, key: str) -> None:
        """A viewer closed it."""
        self._demand.remove(SOURCES.get(key, key))

    def _listen(self, key: str) -> Callable[[], None]:
        topic, name = self._topics[key]
        return self._bus.tap(topic, self._pass_on, name or None)

    def _pass_on(self, sample: Sample) -> None:
        key = sample.key
        if sample.topic.delivery == "latched":
            self._latched[key] = sample.payload
        self._say(key, sample.payload)
        wanted = [channel for channel, source in SOURCES.items() if source == key and sample.topic is not DESCRIPTION]
        if any(self._channels[channel].has_sinks() for channel in wanted):
            self._convert(sample)

    def _convert(self, sample: Sample) -> None:
        message = sample.topic.message()
        try:
            message.ParseFromString(sample.payload)
        except DecodeError:
            self._bus.counters.add(f"malformed_{sample.topic.name}")
            return
        with self._lock:
            converted = self._scene.convert(sample.topic, message)
        if converted is not None:
            self._say(converted.channel, converted.message.SerializeToString())

    def _say(self, key: str, payload: bytes) -> None:
        self._channels[key].log(payload, log_time=time.time_ns())

    # what viewers say

    def published(self, topic: str, encoding: str, payload: bytes) -> None:
        """A viewer published something."""
        if self._targets is None or topic.strip("/") != TARGET.key:
            self.refuse(f"nothing but {TARGET.key} can be published here, and not {topic}")
            return
        try:
            self._targets.put(target_of(encoding, payload))
        except TargetError as error:
            self.refuse(str(error))

    def refuse(self, text: str) -> None:
        """Tells viewers why something was not done."""
        total = self._bus.counters.add("refused_from_viewers")
        if total & (total - 1) == 0:  # a flood stays readable
            log.warning("%s", text, extra={"total": total})
        self._server.publish_status(text, foxglove.StatusLevel.Warning, "armsight")

    def parameters(self, names: Iterable[str]) -> list[foxglove.Parameter]:
        """The configuration that services are in, as ``service.name``; of all that answer where none is named."""
        wanted = set(names)
        found: dict[str, Any] = {}
        for service in SERVICES:
            if wanted and not any(name.startswith(f"{service}.") for name in wanted):
                continue
            try:
                told = self._ask(service)
            except ArmsightError:
                continue  # it is not there: then there are none of it
            values = flattened(told.json) | in_force(told.parameters)
            found |= {f"{service}.{name}": value for name, value in values.items()}
        return [
            foxglove.Parameter(name, value=value)
            for name, value in sorted(found.items())
            if not wanted or name in wanted
        ]

    def set_parameters(self, wanted: Iterable[foxglove.Parameter]) -> None:
        """Sets what a viewer wants set, service by service; viewers are told why something was not."""
        if self._targets is None:
            self.refuse("nothing can be set here: the bridge was started with --read-only")
            return
        by_service: dict[str, dict[str, Any]] = {}
        for parameter in wanted:
            service, _, name = parameter.name.partition(".")
            by_service.setdefault(service, {})[name] = parameter.get_value()
        for service, values in by_service.items():
            try:
                if service not in SERVICES:
                    raise ArmsightError(f"there is no service {service!r}: {', '.join(SERVICES)} have parameters")
                known = {one.name: one for one in self._ask(service).parameters}
                request = {name: given(value, known.get(name)) for name, value in values.items()}
                self._bus.query(SET_PARAMETERS, SetParametersRequest(values=request), service, timeout_s=_PARAMETERS_S)
            except ArmsightError as error:
                self.refuse(str(error))

    def _ask(self, service: str) -> ParametersResponse:
        return self._bus.query(ASK_PARAMETERS, Empty(), service, timeout_s=_PARAMETERS_S)


class _Listener(foxglove.websocket.ServerListener):
    """Hands on what the server says, in threads of its own."""

    def __init__(self, bridge: Bridge) -> None:
        self._bridge = bridge
        self._lock = threading.Lock()
        self._advertised: dict[tuple[int, int], tuple[str, str]] = {}
        """Topic and encoding of what viewers publish, by viewer and channel."""

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        del client
        self._bridge.looked_at(channel.topic)

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        del client
        self._bridge.left(channel.topic)

    def on_client_advertise(self, client: Client, channel: ClientChannel) -> None:
        with self._lock:
            self._advertised[client.id, channel.id] = (channel.topic, channel.encoding)

    def on_client_unadvertise(self, client: Client, client_channel_id: int) -> None:
        with self._lock:
            self._advertised.pop((client.id, client_channel_id), None)

    def on_message_data(self, client: Client, client_channel_id: int, data: bytes) -> None:
        with self._lock:
            topic, encoding = self._advertised.get((client.id, client_channel_id), ("", ""))
        self._bridge.published(topic, encoding, data)

    def on_get_parameters(
        self, client: Client, param_names: list[str], request_id: str | None = None
    ) -> list[foxglove.Parameter]:
        del client, request_id
        return self._bridge.parameters(param_names)

    def on_set_parameters(
        self, client: Client, parameters: list[foxglove.Parameter], request_id: str | None = None
    ) -> list[foxglove.Parameter]:
        del client, request_id
        self._bridge.set_parameters(parameters)
        return self._bridge.parameters([parameter.name for parameter in parameters])
