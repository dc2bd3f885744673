"""A service's configuration and its parameters as single values, and values as viewers give them."""

import json
from collections.abc import Iterable
from typing import Any

from armsight.parameters import value_message
from armsight.v1.parameters_pb2 import Parameter, ParameterValue


def flattened(text: str) -> dict[str, Any]:
    """Values by names with dots; lists and what is empty as text.

    Args:
        text: of ``{service}/parameters``.
    """
    try:
        told = json.loads(text)
    except ValueError:
        return {}
    return dict(_pairs(told, "")) if isinstance(told, dict) else {}


def _pairs(told: dict[str, Any], prefix: str) -> list[tuple[str, Any]]:
    pairs: list[tuple[str, Any]] = []
    for name, value in told.items():
        if isinstance(value, dict):
            pairs += _pairs(value, f"{prefix}{name}.")
        else:
            plain = value if isinstance(value, bool | int | float | str) else json.dumps(value)
            pairs.append((f"{prefix}{name}", plain))
    return pairs


def in_force(parameters: Iterable[Parameter]) -> dict[str, Any]:
    """Values by name of those that may be set."""
    found: dict[str, Any] = {}
    for parameter in parameters:
        kind = parameter.value.WhichOneof("kind")
        if kind is not None:
            found[parameter.name] = getattr(parameter.value, kind)
    return found


def given(value: Any, parameter: Parameter | None) -> ParameterValue:
    """What a viewer wants set: viewers have one kind of number, services two. Bounds are for the service to say."""
    if isinstance(value, float) and value.is_integer() and parameter is not None:
        kind = parameter.value.WhichOneof("kind")
        return ParameterValue(whole=int(value)) if kind == "whole" else ParameterValue(number=value)
    return value_message(value) if isinstance(value, bool | int | float | str) else ParameterValue()
