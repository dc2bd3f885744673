"""Encoding of camera frames: protobuf's own way of it copies the pixels twice and takes twenty times as long."""

import struct

from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from armsight.times import to_timestamp

_SENT = struct.Struct("<Q")
_DATA_TAG = bytes([(RawImage.DATA_FIELD_NUMBER << 3) | 2])


def encode_rgb8(pixels: bytes | memoryview, width: int, height: int, frame_id: str, capture_ns: int) -> bytes:
    """A foxglove.RawImage of rgb8 rows without padding, serialised.

    Args:
        pixels: ``height * width * 3`` bytes, the top row first.
        width: columns.
        height: rows.
        frame_id: name of the camera's optical frame.
        capture_ns: instant of capture, Unix nanoseconds.

    Raises:
        ValueError: the number of bytes does not fit width and height.
    """
    return b"".join((head_of_rgb8(len(pixels), width, height, frame_id, capture_ns), pixels))


def head_of_rgb8(size: int, width: int, height: int, frame_id: str, capture_ns: int) -> bytes:
    """What stands before the pixels in :func:`encode_rgb8`; ``size`` is their bytes.

    Raises:
        ValueError: the number of bytes does not fit width and height.
    """
    if size != width * height * 3:
        raise ValueError(f"{size} bytes are not a {width}x{height} rgb8 image")
    head = RawImage(
        timestamp=to_timestamp(capture_ns),
        frame_id=frame_id,
        width=width,
        height=height,
        encoding="rgb8",
        step=width * 3,
    )
    return b"".join((head.SerializeToString(), _DATA_TAG, _varint(size)))


def encode_sent(ns: int) -> bytes:
    """What goes beside a frame: when it was sent, by the sender's wall clock, Unix nanoseconds."""
    return _SENT.pack(ns)


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)
