"""Writes the descriptors of Foxglove's messages for ``protoc --descriptor_set_in``: ``dump_foxglove.py OUT``.

The wheel carries generated Python only; its descriptors are the schemas, and no copy of them need be kept here.
"""

import importlib
import pkgutil
import sys
from pathlib import Path

import foxglove_schemas_protobuf
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet


def descriptors() -> FileDescriptorSet:
    """All files of the wheel and what they import, each after what it depends on."""
    result = FileDescriptorSet()
    seen: set[str] = set()

    def add(file: FileDescriptor) -> None:
        if file.name in seen:
            return
        seen.add(file.name)
        for dependency in file.dependencies:
            add(dependency)
        file.CopyToProto(result.file.add())

    for module in sorted(pkgutil.iter_modules(foxglove_schemas_protobuf.__path__), key=lambda module: module.name):
        if module.name.endswith("_pb2"):
            add(importlib.import_module(f"foxglove_schemas_protobuf.{module.name}").DESCRIPTOR)
    return result


if __name__ == "__main__":
    target = Path(sys.argv[1])
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(descriptors().SerializeToString(deterministic=True))
