"""Checks a model and says what it describes: `python -m armsight_sim.describe FILE`, which `armsight describe` asks.

One JSON object: `findings`, each with `what`, `mend` and `breaks`; where nothing breaks `description`, the protobuf's
JSON, and the `resolutions` of cameras that have one. `unreadable` alone where there is no model to look at. The exit
code is 0 all the same: it is the asker who judges.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from google.protobuf.json_format import MessageToDict

from armsight_sim.conventions import findings, size_of
from armsight_sim.description import describe_arm
from armsight_sim.errors import ModelError
from armsight_sim.world import load_model


def examined(file: Path) -> dict[str, Any]:
    """What there is to say of a model."""
    try:
        model = load_model(file)
    except ModelError as error:
        return {"unreadable": str(error)}
    found = findings(model)
    said: dict[str, Any] = {"findings": [asdict(finding) for finding in found]}
    if not any(finding.breaks for finding in found):
        described = describe_arm(model)
        said["description"] = MessageToDict(described, preserving_proto_field_name=True)
        sizes = {model.camera(index).name: size_of(model, index) for index in range(model.ncam)}
        said["resolutions"] = {name: size for name, size in sizes.items() if size is not None}
    return said


def main(arguments: Sequence[str]) -> int:
    """Prints it."""
    (file,) = arguments
    print(json.dumps(examined(Path(file))))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
