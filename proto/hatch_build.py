"""Generates the Python side of armsight/v1/*.proto when the package is built or installed."""

from pathlib import Path
from typing import Any

from grpc_tools import protoc
from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class GenerateMessages(BuildHookInterface[Any]):
    """Writes *_pb2.py and *_pb2.pyi beside their .proto files."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Runs protoc over every message file; raises where one does not compile."""
        del version, build_data
        root = Path(self.root)
        files = sorted(str(path.relative_to(root)) for path in root.glob("armsight/v1/*.proto"))
        arguments = [f"-I{root}", f"--python_out={root}", f"--pyi_out={root}", *files]
        include = Path(protoc.__file__).parent / "_proto"
        if protoc.main(["protoc", f"-I{include}", *arguments]) != 0:
            raise RuntimeError(f"protoc failed on {files}: see its message above")
