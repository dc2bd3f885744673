"""Which instant a message tells of: its capture time, the key that everything is joined on."""

from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

from armsight.times import from_timestamp

# In this order: a message that answers an instant may have other times beside it.
_FIELDS = ("capture_time", "answers", "timestamp", "now")


def instant_of(message: Message) -> int | None:
    """The instant, Unix nanoseconds; none where the message has no time of its own."""
    if isinstance(message, ImageAnnotations):
        stamps = [
            shape.timestamp for shapes in (message.texts, message.circles, message.points) for shape in shapes[:1]
        ]
        return from_timestamp(stamps[0]) if stamps else None
    for name in _FIELDS:
        field = message.DESCRIPTOR.fields_by_name.get(name)
        if field is not None and field.message_type is Timestamp.DESCRIPTOR and message.HasField(name):
            return from_timestamp(getattr(message, name))
    return None
