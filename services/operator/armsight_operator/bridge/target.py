"""Targets as viewers publish them, made into those of the bus."""

import json
import math

from foxglove_schemas_protobuf.Point3InFrame_pb2 import Point3InFrame
from google.protobuf.json_format import ParseDict, ParseError
from google.protobuf.message import DecodeError

from armsight.times import to_timestamp, wall_ns
from armsight_operator.errors import OperatorError

FRAMES = ("base", "world")


class TargetError(OperatorError):
    """What a viewer published can't be a target."""


def target_of(encoding: str, payload: bytes) -> Point3InFrame:
    """A target from a viewer's message, with the time of now.

    Args:
        encoding: ``protobuf`` (a ``foxglove.Point3InFrame``), or ``json``: one of these, or of the shape of
            ``geometry_msgs/PointStamped``, as 3D panels publish where one clicks.
        payload: the message.

    Raises:
        TargetError: it is none, and why.
    """
    message = _from_json(payload) if encoding == "json" else _from_protobuf(encoding, payload)
    if message.frame_id not in FRAMES:
        raise TargetError(f"a target's frame is {' or '.join(FRAMES)}, not {message.frame_id!r}")
    if not message.HasField("point") or not all(
        map(math.isfinite, (message.point.x, message.point.y, message.point.z))
    ):
        raise TargetError("a target needs three finite numbers, point.x, point.y and point.z")
    message.timestamp.CopyFrom(to_timestamp(wall_ns()))
    return message


def _from_protobuf(encoding: str, payload: bytes) -> Point3InFrame:
    if encoding != "protobuf":
        raise TargetError(f"a target is published as json or protobuf, not {encoding!r}")
    message = Point3InFrame()
    try:
        message.ParseFromString(payload)
    except DecodeError as error:
        raise TargetError(f"not a foxglove.Point3InFrame: {error}") from error
    return message


def _from_json(payload: bytes) -> Point3InFrame:
    try:
        told = json.loads(payload)
        frame = told.get("frame_id", told.get("header", {}).get("frame_id", ""))
        return ParseDict({"frame_id": frame, "point": told["point"]}, Point3InFrame(), ignore_unknown_fields=True)
    except (ValueError, TypeError, AttributeError, KeyError, ParseError, RecursionError) as error:
        example = '{"frame_id": "base", "point": {"x": 3, "y": 1, "z": 7}}'
        raise TargetError(f"not a target such as {example}") from error
