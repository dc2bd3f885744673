"""Writes what is generated of the documentation below each page's own text: `.venv/bin/python tools/reference_docs.py`.

The pages are kept in git, so that they can be read without building anything and a change of the contract shows in its
review; a test holds them to what is written here.
"""

import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    EnumDescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.message import Message
from grpc_tools import protoc

from armsight.topics import QUERIES, TOPICS, Query, Topic
from armsight_operator.cli.reference import reference

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PROTO = ROOT / "proto"

_OURS = ".armsight.v1."
# Numbers of fields in descriptor.proto, of which the paths of comments are made.
_MESSAGE, _ENUM, _FIELD, _VALUE = 4, 5, 2, 2


@dataclass(frozen=True, slots=True)
class Generated:
    """A page whose text from one line on is made from the code."""

    page: Path
    begin: str
    make: Callable[[], str]

    def text(self, before: str) -> str:
        """The page with what is generated made anew."""
        return f"{before.partition(self.begin)[0]}{self.begin}\n{self.make()}"


def described() -> FileDescriptorSet:
    """Our messages as protoc understands them, with the comments of their sources."""
    files = sorted(str(path.relative_to(PROTO)) for path in PROTO.glob("armsight/v1/*.proto"))
    known = Path(protoc.__file__).parent / "_proto"
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "messages.bin"
        include = [f"-I{known}", f"-I{PROTO}"]
        if protoc.main(["protoc", *include, "--include_source_info", f"--descriptor_set_out={out}", *files]) != 0:
            raise RuntimeError(f"protoc failed on {files}: see its message above")
        return FileDescriptorSet.FromString(out.read_bytes())


def messages() -> str:
    """Markdown: every message and enumeration with the comments of its source."""
    carriers = _carriers()
    return "\n".join(line for file in described().file for line in _file(file, carriers))


def keys() -> str:
    """Markdown: the contract's table, topics and queries."""
    lines = ["### Topics", "", "| key | message | who puts it | who reads it | delivery | priority | ring |"]
    lines += ["|---|---|---|---|---|---|---|", *map(_topic_row, TOPICS), ""]
    lines += ["### Queries", "", "| key | asked | answered | who answers | who may ask |", "|---|---|---|---|---|"]
    return "\n".join([*lines, *map(_query_row, QUERIES), ""])


def _file(file: FileDescriptorProto, carriers: Mapping[str, list[str]]) -> Iterator[str]:
    comments = {tuple(at.path): at.leading_comments or at.trailing_comments for at in file.source_code_info.location}
    yield f"### {file.name}\n"
    for i, message in enumerate(file.message_type):
        yield from _message(message, (_MESSAGE, i), comments, carriers)
    for i, enum in enumerate(file.enum_type):
        yield from _enum(enum, (_ENUM, i), comments)


def _message(
    message: DescriptorProto,
    path: tuple[int, ...],
    comments: Mapping[tuple[int, ...], str],
    carriers: Mapping[str, list[str]],
) -> Iterator[str]:
    yield f"#### {message.name}\n"
    if comment := _joined(comments.get(path, "")):
        yield f"{comment}\n"
    if on := carriers.get(f"armsight.v1.{message.name}"):
        yield f"Goes over the bus as {', '.join(on)} ([keys](keys.md)).\n"
    if not message.field:
        yield "No fields.\n"
        return
    maps = {
        f".armsight.v1.{message.name}.{entry.name}": entry for entry in message.nested_type if entry.options.map_entry
    }
    yield "| field | type | |"
    yield "|---|---|---|"
    for i, field in enumerate(message.field):
        comment = _joined(comments.get((*path, _FIELD, i), ""))
        if field.HasField("oneof_index") and not field.proto3_optional:
            comment = f"{comment} One of `{message.oneof_decl[field.oneof_index].name}`.".strip()
        yield f"| `{field.name}` = {field.number} | {_type(field, maps)} | {comment} |"
    yield ""


def _enum(enum: EnumDescriptorProto, path: tuple[int, ...], comments: Mapping[tuple[int, ...], str]) -> Iterator[str]:
    yield f"#### {enum.name}\n"
    if comment := _joined(comments.get(path, "")):
        yield f"{comment}\n"
    yield "| value | |"
    yield "|---|---|"
    for i, value in enumerate(enum.value):
        yield f"| `{value.name}` = {value.number} | {_joined(comments.get((*path, _VALUE, i), ''))} |"
    yield ""


def _type(field: FieldDescriptorProto, maps: Mapping[str, DescriptorProto]) -> str:
    if entry := maps.get(field.type_name):
        key, value = entry.field
        return f"map of {_one(key)} to {_one(value)}"
    if field.label == FieldDescriptorProto.LABEL_REPEATED:
        return f"{_one(field)}, repeated"
    return f"{_one(field)}, optional" if field.proto3_optional else _one(field)


def _one(field: FieldDescriptorProto) -> str:
    if field.type_name.startswith(_OURS):
        name = field.type_name.removeprefix(_OURS)
        return f"[{name}](#{name.lower()})"
    if field.type_name:
        return f"`{field.type_name.removeprefix('.')}`"
    return FieldDescriptorProto.Type.Name(field.type).removeprefix("TYPE_").lower()


def _joined(comment: str) -> str:
    return " ".join(comment.split()).replace("|", "\\|")


def _carriers() -> dict[str, list[str]]:
    """Full name of a message → the keys that it is put on, asked with or answered with."""
    found: dict[str, list[str]] = {}
    for topic in TOPICS:
        found.setdefault(topic.message.DESCRIPTOR.full_name, []).append(f"`{topic.key}`")
    for query in QUERIES:
        found.setdefault(query.request.DESCRIPTOR.full_name, []).append(f"question to `{query.key}`")
        found.setdefault(query.response.DESCRIPTOR.full_name, []).append(f"answer of `{query.key}`")
    return found


def _topic_row(topic: "Topic[Any]") -> str:
    delivery = f"{topic.delivery}, express" if topic.express else topic.delivery
    cells = [_named(topic.message), _who(topic.publishers), _who(topic.readers), delivery, topic.priority.lower()]
    return f"| `{topic.key}` | {' | '.join(cells)} | {topic.ring} |"


def _query_row(query: "Query[Any, Any]") -> str:
    cells = [_named(query.request), _named(query.response), _who(query.servers), _who(query.callers)]
    return f"| `{query.key}` | {' | '.join(cells)} |"


def _named(message: type[Message]) -> str:
    name = message.DESCRIPTOR.full_name
    if name.startswith(_OURS[1:]):
        short = name.removeprefix(_OURS[1:])
        return f"[{short}](messages.md#{short.lower()})"
    return "nothing" if name == "google.protobuf.Empty" else f"`{name}`"


def _who(names: Iterable[str]) -> str:
    return ", ".join(names)


PAGES = (
    Generated(DOCS / "cli.md", "## Commands\n", reference),
    Generated(DOCS / "keys.md", "## The table\n", keys),
    Generated(DOCS / "messages.md", "## By file\n", messages),
)


if __name__ == "__main__":
    for each in PAGES:
        each.page.write_text(each.text(each.page.read_text(encoding="utf-8")), encoding="utf-8")
