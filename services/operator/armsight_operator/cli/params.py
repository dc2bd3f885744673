"""`armsight params list | get | set`: what may be changed while a service runs."""

import json
import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armsight_operator.cli.options import Connect, Namespace, ZenohConfig

if TYPE_CHECKING:
    from armsight.bus import Bus
    from armsight.v1.parameters_pb2 import Parameter, ParameterValue

app = typer.Typer(
    help="See and set what may be changed while a service runs.", no_args_is_help=True, rich_markup_mode=None
)

_PATIENCE_S = 2.0

Service = Annotated[str, typer.Argument(help="sim, vision or control.")]


@app.command("list")
def list_parameters(
    service: Annotated[str | None, typer.Argument(help="Only of this service.", show_default=False)] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object: service, parameter, value.")] = False,
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """List every parameter with its value, its bounds and what it does.

    Example: armsight params list control
    """
    from armsight.errors import NoReplyError
    from armsight.topics import SERVICES
    from armsight_operator.cli.bus import configuration, connected
    from armsight_operator.errors import NoDataError

    found: dict[str, list[Parameter]] = {}
    silent: list[str] = []
    with connected(configuration(connect, namespace, zenoh_config)) as bus:
        for name in SERVICES if service is None else (service,):
            try:
                found[name] = _ask(bus, name)
            except NoReplyError:
                silent.append(name)
    if as_json:
        print(json.dumps({name: {one.name: _value(one.value) for one in these} for name, these in found.items()}))
    elif found:
        _print_table(found)
    if silent:
        raise NoDataError(f"{' and '.join(silent)} did not answer: is it running? see `armsight status`")


@app.command("get")
def get_parameter(
    service: Service,
    name: Annotated[str, typer.Argument(help="A parameter of `armsight params list`.")],
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Print the value of one parameter.

    Example: armsight params get control speed
    """
    from armsight_operator.cli.bus import configuration, connected

    with connected(configuration(connect, namespace, zenoh_config)) as bus:
        print(_shown(_find(_ask(bus, service), service, name).value))


@app.command("set")
def set_parameters(
    service: Service,
    values: Annotated[list[str], typer.Argument(metavar="NAME=VALUE...", help="All are set, or none.")],
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Set parameters, all of them or none, until the service ends.

    Example: armsight params set control speed=0.1
    """
    from armsight import topics
    from armsight.v1.parameters_pb2 import SetParametersRequest
    from armsight_operator.cli.bus import configuration, connected

    given = _assignments(values)
    with connected(configuration(connect, namespace, zenoh_config)) as bus:
        known = _ask(bus, service)
        wanted = {name: parse(text, _find(known, service, name)) for name, text in given.items()}
        response = bus.query(topics.SET_PARAMETERS, SetParametersRequest(values=wanted), service)
    for name in given:
        print(f"{name} = {_shown(_find(response.parameters, service, name).value)}")


def parse(text: str, parameter: "Parameter") -> "ParameterValue":
    """A value as a person types it; its bounds are for the service to say.

    Raises:
        ConfigError: it is not of the parameter's kind.
    """
    from armsight.errors import ConfigError
    from armsight.v1.parameters_pb2 import ParameterValue

    kind = parameter.value.WhichOneof("kind")
    try:
        if kind == "whole":
            return ParameterValue(whole=int(text))
        if kind == "number":
            return ParameterValue(number=float(text))
    except ValueError as error:  # also of a whole number beyond 64 bits
        number = "whole number" if kind == "whole" else "number"
        raise ConfigError(f"{parameter.name} is a {number}, not {text!r}") from error
    if kind == "flag":
        if text not in ("true", "false"):
            raise ConfigError(f"{parameter.name} is true or false, not {text!r}")
        return ParameterValue(flag=text == "true")
    return ParameterValue(text=text)


def _assignments(values: list[str]) -> dict[str, str]:
    from armsight.errors import ConfigError

    given: dict[str, str] = {}
    for value in values:
        name, equals, text = value.partition("=")
        if not (name and equals):
            raise ConfigError(f"expected NAME=VALUE, not {value!r}")
        if name in given:
            raise ConfigError(f"{name} is given twice")
        given[name] = text
    return given


def _ask(bus: "Bus", service: str) -> "list[Parameter]":
    from google.protobuf.empty_pb2 import Empty

    from armsight import topics
    from armsight.errors import ConfigError

    if not service or any(sign in service for sign in "/*$#?"):
        raise ConfigError(f"{service!r} is not the name of a service: see `armsight status`")
    return list(bus.query(topics.ASK_PARAMETERS, Empty(), service, timeout_s=_PATIENCE_S).parameters)


def _find(parameters: Any, service: str, name: str) -> "Parameter":
    from armsight.errors import ConfigError

    for parameter in parameters:
        if parameter.name == name:
            return parameter  # type: ignore[no-any-return]
    raise ConfigError(f"{service} has no parameter {name!r}: see `armsight params list {service}`")


def _value(value: "ParameterValue") -> Any:
    kind = value.WhichOneof("kind")
    return getattr(value, kind) if kind else None


def _shown(value: "ParameterValue") -> str:
    plain = _value(value)
    if isinstance(plain, bool):
        return str(plain).lower()
    return f"{plain:g}" if isinstance(plain, float) else str(plain)


def _bounds(parameter: "Parameter") -> str:
    kind = parameter.value.WhichOneof("kind")
    if kind in ("number", "whole"):
        return f"{parameter.least:g} to {parameter.most:g} {parameter.unit}".rstrip()
    return "true, false" if kind == "flag" else ", ".join(parameter.choices)


def _print_table(found: "dict[str, list[Parameter]]") -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("service", "parameter", "value", "within", "", box=None, pad_edge=False)
    for service, parameters in found.items():
        for one in parameters:
            table.add_row(service, one.name, _shown(one.value), _bounds(one), one.description)
    Console(width=None if sys.stdout.isatty() else 160, soft_wrap=True).print(table, highlight=False)
