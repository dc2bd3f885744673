"""The descriptors of every message on the bus, for tools that decode without our code."""

from collections.abc import Iterable
from typing import Any

from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message

from armsight.topics import TOPICS


def descriptor_set(messages: Iterable[type[Message]] | None = None) -> FileDescriptorSet:
    """Files of some messages (all topics' where none are named) and of what they import, each after what it needs."""
    files: dict[str, FileDescriptor] = {}

    def add(file: FileDescriptor) -> None:
        if file.name in files:
            return
        for dependency in file.dependencies:
            add(dependency)
        files[file.name] = file

    chosen: Iterable[type[Message]] = (topic.message for topic in TOPICS) if messages is None else messages
    for message in chosen:
        file: Any = message.DESCRIPTOR.file  # of the C implementation, whatever the stubs make of it
        add(file)
    result = FileDescriptorSet()
    for file in files.values():
        file.CopyToProto(result.file.add())
    return result
