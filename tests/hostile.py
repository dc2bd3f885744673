"""Bytes that no service of ours puts, made from such as ours do put."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

from armsight.topics import Topic, encoding_of

_FLOATS = (float("nan"), float("inf"), float("-inf"), 1e308, -1e308, 5e-324, -0.0, 1e9)
_WHOLE_32 = (0, -1, 1, 2**31 - 1, -(2**31))
_WHOLE_64 = (0, -1, 1, 2**63 - 1, -(2**63))
_POSITIVE_32 = (0, 1, 2**16, 2**31, 2**32 - 1)
_POSITIVE_64 = (0, 1, 2**32, 2**63, 2**64 - 1)
_TEXTS = ("", "\x00", "a/b", "*", "${x}", "joint1" * 2000, "é" * 40)

_VALUES: dict[int, Sequence[object]] = {
    FieldDescriptor.TYPE_DOUBLE: _FLOATS,
    FieldDescriptor.TYPE_FLOAT: tuple(value for value in _FLOATS if abs(value) != 1e308),
    FieldDescriptor.TYPE_INT32: _WHOLE_32,
    FieldDescriptor.TYPE_INT64: _WHOLE_64,
    FieldDescriptor.TYPE_UINT32: _POSITIVE_32,
    FieldDescriptor.TYPE_UINT64: _POSITIVE_64,
    FieldDescriptor.TYPE_FIXED32: _POSITIVE_32,
    FieldDescriptor.TYPE_FIXED64: _POSITIVE_64,
    FieldDescriptor.TYPE_ENUM: (0, -1, 99, 2**31 - 1),
    FieldDescriptor.TYPE_BOOL: (False, True),
    FieldDescriptor.TYPE_STRING: _TEXTS,
    FieldDescriptor.TYPE_BYTES: (b"", b"\xff" * 3, bytes(4096)),
}


T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Case:
    """One put."""

    kind: str
    payload: bytes
    encoding: str


def cases(
    topic: Topic[Any], genuine: Sequence[bytes], foreign: Sequence[bytes], random: np.random.Generator, count: int
) -> Iterator[Case]:
    """So many puts for a key.

    Args:
        topic: of the key.
        genuine: what was put on it, at least one.
        foreign: what was put on other keys.
        random: where all chance comes from.
        count: how many.
    """
    own = encoding_of(topic.message)
    for _ in range(count):
        payload = one_of(genuine, random)
        match random.integers(8):
            case 0:
                yield Case("noise", random.bytes(int(random.integers(0, 2000))), own)
            case 1:
                yield Case("truncated", payload[: random.integers(len(payload) + 1)], own)
            case 2:
                yield Case("flipped", flipped(payload[:100_000], random), own)
            case 3 | 4:
                yield Case("out of range", out_of_range(topic.message, payload, random), own)
            case 5:
                yield Case("another schema", one_of(foreign, random)[:100_000], own)
            case 6:
                encodings = ("", "application/protobuf", "application/protobuf;armsight.v1.Nothing", own + " ")
                yield Case("another encoding", payload, one_of(encodings, random))
            case _:
                yield Case("replayed", payload, own)


def flipped(payload: bytes, random: np.random.Generator) -> bytes:
    """Some bits are the other way."""
    changed = np.frombuffer(payload, dtype=np.uint8).copy()
    for _ in range(int(random.integers(1, 8)) if len(changed) else 0):
        changed[random.integers(len(changed))] ^= 1 << random.integers(8)
    return changed.tobytes()


def out_of_range(message: type[Message], payload: bytes, random: np.random.Generator) -> bytes:
    """A valid message of which some fields have values that nothing sensible has, or stand there many times."""
    changed = message()
    changed.ParseFromString(payload)
    for _ in range(int(random.integers(1, 4))):
        _spoil(changed, random)
    return changed.SerializeToString()


def _spoil(message: Message, random: np.random.Generator) -> None:
    fields: Sequence[Any] = message.DESCRIPTOR.fields  # whichever implementation's
    field = one_of(fields, random)
    value = getattr(message, field.name)
    if field.message_type is not None and field.message_type.GetOptions().map_entry:
        message.ClearField(field.name)
    elif field.is_repeated and len(value) == 0:
        if field.message_type is not None:
            value.add()
        else:
            value.extend([_value_of(field, random)])
    elif field.is_repeated:
        which = int(random.integers(len(value)))
        if random.integers(4) == 0:
            value.extend([value[which]] * int(random.integers(1, 300)))  # and nobody said how many there may be
        elif random.integers(4) == 0:
            del value[which]
        elif field.message_type is not None:
            _spoil(value[which], random)
        else:
            value[which] = _value_of(field, random)
    elif field.message_type is not None:
        if random.integers(5) == 0 or not field.message_type.fields:
            message.ClearField(field.name)
        else:
            value.SetInParent()
            _spoil(value, random)
    else:
        setattr(message, field.name, _value_of(field, random))


def _value_of(field: Any, random: np.random.Generator) -> object:
    return one_of(_VALUES[field.type], random)


def one_of(choices: Sequence[T], random: np.random.Generator) -> T:
    """Each as likely as the others."""
    return choices[int(random.integers(len(choices)))]
