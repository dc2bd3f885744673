"""The descriptors of every message on the bus, for tools that decode without our code."""

from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from armsight.topics import TOPICS


def descriptor_set() -> FileDescriptorSet:
    """Files of all topics' messages and of what they import, each after what it depends on."""
    files: dict[str, FileDescriptor] = {}

    def add(file: FileDescriptor) -> None:
        if file.name in files:
            return
        for dependency in file.dependencies:
            add(dependency)
        files[file.name] = file

    for topic in TOPICS:
        add(topic.message.DESCRIPTOR.file)
    result = FileDescriptorSet()
    for file in files.values():
        file.CopyToProto(result.file.add())
    return result
