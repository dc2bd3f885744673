"""Which instant a message tells of: its capture time, the key that everything is joined on."""

from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

from armsight.times import from_timestamp

# In this order: a message that answers an instant may have other times beside it.
_FIELDS = ("capture_time", "answers", "timestamp", "now")


_LATEST_NS = 2**63 - 1
"""What a file's index can name; whoever says a later time, or one before 1970, has none that can be told."""


def instant_of(message: Message) -> int | None:
    """The instant, Unix nanoseconds; none where the message has no time of its own, or one that no clock shows."""
    stamp = _stamp_of(message)
    if stamp is None:
        return None
    ns = from_timestamp(stamp)
    return ns if 0 <= ns <= _LATEST_NS else None


def _stamp_of(message: Message) -> Timestamp | None:
    if isinstance(message, ImageAnnotations):
        shapes = [shape for shapes in (message.texts, message.circles, message.points) for shape in shapes[:1]]
        return shapes[0].timestamp if shapes else None
    for name in _FIELDS:
        field = message.DESCRIPTOR.fields_by_name.get(name)
        if field is not None and field.message_type is Timestamp.DESCRIPTOR and message.HasField(name):
            stamp: Timestamp = getattr(message, name)
            return stamp
    return None
