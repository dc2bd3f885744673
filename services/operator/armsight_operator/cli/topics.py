"""`armsight topics list | echo | rate`: what goes over the bus."""

import json
import sys
import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armsight_operator.cli.options import Connect, Namespace, ZenohConfig
from armsight_operator.errors import NoDataError

if TYPE_CHECKING:
    from armsight.topics import Topic

app = typer.Typer(help="See what goes over the bus.", no_args_is_help=True, rich_markup_mode=None)

_LONG_FIELDS = ("data",)
_SILENCE_S = 5.0

AsJson = Annotated[bool, typer.Option("--json", help="JSON, for programs.")]
Key = Annotated[str, typer.Argument(help="A key of `armsight topics list`, e.g. joints/positions or camera/1/pose.")]


@app.command("list")
def list_topics(as_json: AsJson = False) -> None:
    """List every key with its message, publisher and quality of service.

    Example: armsight topics list
    """
    from rich.console import Console
    from rich.table import Table

    from armsight.topics import TOPICS

    if as_json:
        print(json.dumps([_as_dict(topic) for topic in TOPICS]))
        return
    table = Table("key", "message", "from", "delivery", "priority", box=None, pad_edge=False)
    for topic in TOPICS:
        table.add_row(
            topic.key, topic.message.DESCRIPTOR.full_name, ", ".join(topic.publishers), topic.delivery, topic.priority
        )
    Console(width=None if sys.stdout.isatty() else 160, soft_wrap=True).print(table)


@app.command()
def echo(
    key: Key,
    count: Annotated[int, typer.Option("--count", "-n", help="End after so many messages; 0: never.", min=0)] = 0,
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Print messages as JSON, one a line, pixels left out.

    Example: armsight topics echo joints/positions --count 1
    """
    from google.protobuf.json_format import MessageToJson, SerializeToJsonError

    from armsight_operator.cli.bus import configuration, connected

    topic, name = _find(key)
    with connected(configuration(connect, namespace, zenoh_config)) as bus:
        subscriber = bus.subscriber(topic, name)
        seen = 0
        while count == 0 or seen < count:
            received = subscriber.recv(_SILENCE_S)
            if received is None:
                raise NoDataError(
                    f"nothing on {key} for {_SILENCE_S:g} s: does its publisher, {_publisher(topic)}, run?"
                )
            message = received.message
            for long_field in _LONG_FIELDS:
                if long_field in message.DESCRIPTOR.fields_by_name:
                    message.ClearField(long_field)
            try:
                print(MessageToJson(message, indent=None, preserving_proto_field_name=True), flush=True)
            except SerializeToJsonError as error:  # a time that no calendar has
                print(f"no JSON can say what is on {received.key}: {error}", file=sys.stderr, flush=True)
            seen += 1


@app.command()
def rate(
    key: Key,
    seconds: Annotated[float, typer.Option(help="Seconds to count.", min=0.1, max=3600)] = 3.0,
    as_json: AsJson = False,
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Count messages a second and their mean size.

    Example: armsight topics rate camera/1/image --seconds 5
    """
    from armsight_operator.cli.bus import configuration, connected

    topic, name = _find(key)
    with connected(configuration(connect, namespace, zenoh_config)) as bus:
        sizes: list[int] = []
        subscriber = bus.subscriber(
            topic, name, keep=256, on_message=lambda received: sizes.append(received.message.ByteSize())
        )
        time.sleep(seconds)
        subscriber.close()
    if not sizes:
        raise NoDataError(f"nothing on {key} for {seconds:g} s: does its publisher, {_publisher(topic)}, run?")
    rate_hz, mean_bytes = len(sizes) / seconds, sum(sizes) / len(sizes)
    if as_json:
        print(json.dumps({"key": key, "messages": len(sizes), "rate_hz": rate_hz, "mean_bytes": mean_bytes}))
    else:
        print(f"{rate_hz:.1f} Hz, {mean_bytes / 1e3:.1f} kB each")


def _as_dict(topic: "Topic[Any]") -> dict[str, Any]:
    return {
        "key": topic.key,
        "message": topic.message.DESCRIPTOR.full_name,
        "publishers": topic.publishers,
        "readers": topic.readers,
        "delivery": topic.delivery,
        "priority": topic.priority,
    }


def _publisher(topic: "Topic[Any]") -> str:
    return " or ".join(topic.publishers)


def _find(key: str) -> "tuple[Topic[Any], str | None]":
    from armsight.errors import ConfigError
    from armsight.topics import TOPICS

    parts = key.strip("/").split("/")
    for topic in TOPICS:
        pattern = topic.key.split("/")
        if len(pattern) == len(parts) and all(a in (b, "{name}") for a, b in zip(pattern, parts, strict=True)):
            named = [b for a, b in zip(pattern, parts, strict=True) if a == "{name}"]
            if named and named[0] == "{name}":
                raise ConfigError(f"put a name in the place of {{name}} in {key}, e.g. {topic.key_for('1')}; * is all")
            return topic, named[0] if named else None
    raise ConfigError(f"no key {key!r}: see `armsight topics list`")
