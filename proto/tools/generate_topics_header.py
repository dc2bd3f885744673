"""Writes the C++ side of topics.toml: ``generate_topics_header.py TOPICS.toml OUT.hpp``."""

import sys
import tomllib
from pathlib import Path
from typing import Any

# Zenoh's priorities, from the most urgent.
_PRIORITIES = {
    "REAL_TIME": 1,
    "INTERACTIVE_HIGH": 2,
    "INTERACTIVE_LOW": 3,
    "DATA_HIGH": 4,
    "DATA": 5,
    "DATA_LOW": 6,
    "BACKGROUND": 7,
}

_HEAD = """#pragma once
// Generated from proto/armsight/topics.toml by proto/tools/generate_topics_header.py.

#include <cstddef>
#include <cstdint>
#include <string_view>

namespace armsight::topics {

/// What a full queue does, and whether late subscribers get the last value.
enum class Delivery { Latched, Drop, Block };

/// One row of the table.
struct Topic {
    std::string_view name;
    std::string_view key;       ///< relative to the session's namespace; {name} stands for one chunk
    std::string_view encoding;  ///< that every put carries
    Delivery delivery;
    std::uint8_t priority;      ///< Zenoh's, 1 (REAL_TIME) to 7 (BACKGROUND)
    std::size_t ring;           ///< samples that a subscriber of the loop keeps
    bool express;
};

/// A queryable.
struct Query {
    std::string_view name;
    std::string_view key;
    std::string_view request_encoding;
    std::string_view response_encoding;
};

"""


def constant(name: str) -> str:
    """``camera_image`` as ``kCameraImage``."""
    return "k" + "".join(part.capitalize() for part in name.split("_"))


def encoding(message: str) -> str:
    """The encoding of a message by its full name."""
    return f"application/protobuf;{message or 'google.protobuf.Empty'}"


def topic(row: dict[str, Any]) -> str:
    """One topic's constant."""
    delivery = f"Delivery::{row['delivery'].capitalize()}"
    express = "true" if row.get("express", False) else "false"
    values = f'"{row["name"]}", "{row["key"]}", "{encoding(row["message"])}", {delivery}'
    return (
        f"inline constexpr Topic {constant(row['name'])}"
        f"{{{values}, {_PRIORITIES[row['priority']]}, {row['ring']}, {express}}};\n"
    )


def query(row: dict[str, Any]) -> str:
    """One queryable's constant."""
    values = f'"{row["name"]}", "{row["key"]}", "{encoding(row["request"])}", "{encoding(row["response"])}"'
    return f"inline constexpr Query {constant(row['name'])}Query{{{values}}};\n"


def main() -> None:
    """Reads the table, writes the header."""
    source, target = map(Path, sys.argv[1:])
    table = tomllib.loads(source.read_text(encoding="utf-8"))
    body = [*map(topic, table["topic"]), "\n", *map(query, table["query"])]
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(_HEAD + "".join(body) + "\n}  // namespace armsight::topics\n", encoding="utf-8")


if __name__ == "__main__":
    main()
