"""A service's configuration, one JSON object, as single values."""

import json
from typing import Any


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
