"""One MCAP file while it is written: what is in it can be read at any time, whatever happens to who writes it.

Messages are gathered into chunks, each written whole at least once a second. Room for the chunk that is gathered and
for the index at the end is set aside on the disk before it is needed: a full disk ends the file, and the file is whole.
"""

import ctypes
import errno
import os
from collections.abc import Mapping
from pathlib import Path

from google.protobuf.message import Message
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer

from armsight.schema import descriptor_set
from armsight.service import VERSION
from armsight.topics import encoding_of

COMPRESSIONS = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}

_CHUNK_BYTES = 4 << 20
_AHEAD_BYTES = 8 << 20
"""Set aside at a time: seldom enough to cost nothing."""
_KEEP_SIZE = 1
"""FALLOC_FL_KEEP_SIZE: blocks are set aside, the file's size stays what was written."""

# Of the index at the end, with some to spare.
_INDEX_BYTES = 1 << 16
_INDEX_BYTES_PER_CHUNK = 1 << 10
_INDEX_BYTES_PER_MESSAGE = 32

_libc = ctypes.CDLL(None, use_errno=True)


class _Output:
    """What the library writes to: unbuffered, and with room set aside."""

    def __init__(self, path: Path, *, overwrite: bool) -> None:
        self._file = path.open("wb" if overwrite else "xb", buffering=0)
        self._written = 0
        self._set_aside = 0
        self._can_set_aside = True

    def write(self, data: bytes) -> int:
        view = memoryview(data)
        while view:
            done = self._file.write(view)
            self._written += done
            view = view[done:]
        return len(data)

    def tell(self) -> int:
        return self._written

    def flush(self) -> None:
        """Nothing is kept back."""

    def set_aside(self, size: int) -> None:
        """Room for so many more bytes.

        Raises:
            OSError: there is none.
        """
        needed = self._written + size
        if needed <= self._set_aside or not self._can_set_aside:
            return
        try:
            self._allocate(needed + _AHEAD_BYTES)
        except OSError as error:
            if error.errno in (errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL):
                self._can_set_aside = False  # not on this file system: a full disk is noticed when it is
                return
            self._allocate(needed)

    def cut(self, size: int) -> None:
        """Leaves only the first bytes, and gives room that was set aside back."""
        self._file.truncate(size)
        self._written = size
        self._file.seek(size)

    def close(self) -> None:
        self._file.close()

    def _allocate(self, until: int) -> None:
        offset, length = ctypes.c_int64(self._set_aside), ctypes.c_int64(until - self._set_aside)
        if _libc.fallocate(self._file.fileno(), _KEEP_SIZE, offset, length) != 0:
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number))
        self._set_aside = until


class McapFile:
    """Channels are made as they are needed; their schemas are file descriptor sets, whole with what they import."""

    def __init__(self, path: Path, metadata: Mapping[str, str], compression: str = "zstd", *, overwrite: bool = False):
        """Makes the file.

        Args:
            path: must not exist, unless it may be overwritten.
            metadata: told in the record ``armsight`` at the beginning.
            compression: one of :data:`COMPRESSIONS`.
            overwrite: whether a file that is there is replaced.

        Raises:
            OSError: it can't be made.
        """
        self.path = path
        self._output = _Output(path, overwrite=overwrite)
        self._writer = Writer(
            self._output,  # type: ignore[arg-type]  # all of a stream that the writer uses
            chunk_size=_CHUNK_BYTES,
            compression=COMPRESSIONS[compression],
        )
        self._broken: OSError | None = None
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._schema_bytes = 0
        self._gathered_bytes = 0
        self._gathered = 0
        self._chunks = 0
        self._writer.start(library=f"armsight {VERSION}")
        self._writer.add_metadata("armsight", dict(metadata))
        self._whole_until = self._output.tell()

    @property
    def size(self) -> int:
        """Bytes of the file by now, and of what is gathered."""
        return self._output.tell() + self._gathered_bytes

    def write(
        self,
        key: str,
        message: type[Message],
        payload: bytes,
        times_ns: tuple[int, int],
        sequence: int,
        metadata: Mapping[str, str],
    ) -> None:
        """Adds a message.

        Args:
            key: the channel.
            message: its type.
            payload: serialised.
            times_ns: when it came, and the instant that it tells of.
            sequence: of its key.
            metadata: of the channel.

        Raises:
            OSError: no room; what was added before is in the file once :meth:`finish` was called.
        """
        try:
            self._set_aside(len(payload))
        except OSError:
            if not self._gathered:
                raise
            self.flush()  # compressed it takes less than was set aside for it
            self._set_aside(len(payload))
        self._gathered += 1
        log_ns, publish_ns = times_ns

        def add() -> None:
            channel = self._channel(key, message, metadata)
            self._writer.add_message(channel, log_ns, payload, publish_ns, sequence)

        self._guarded(add)
        if self._output.tell() == self._whole_until:
            self._gathered_bytes += len(payload) + _INDEX_BYTES_PER_MESSAGE
        else:
            self._chunk_is_written()

    def flush(self) -> None:
        """Writes the chunk that is gathered.

        Raises:
            OSError: no room for it; the file holds all chunks before.
        """
        if self._gathered:
            self._guarded(self._writer.flush)
            self._chunk_is_written()

    def finish(self, metadata: Mapping[str, str]) -> None:
        """Writes what is gathered, a record ``armsight end`` and the index, and closes the file.

        Raises:
            OSError: no room for it; the file holds all chunks before.
        """
        try:
            if self._broken is not None:
                raise self._broken
            self.flush()
            self._guarded(lambda: self._writer.add_metadata("armsight end", dict(metadata)))
            self._guarded(self._writer.finish)
        finally:
            self._output.cut(self._output.tell())
            self._output.close()

    def _set_aside(self, size: int) -> None:
        """Room for one more message in the chunk that is gathered, and for the index."""
        index = _INDEX_BYTES + self._schema_bytes + _INDEX_BYTES_PER_CHUNK * self._chunks
        index += _INDEX_BYTES_PER_MESSAGE * (self._gathered + 1)
        self._output.set_aside(self._gathered_bytes + size + index)

    def _guarded(self, write) -> None:  # type: ignore[no-untyped-def]
        try:
            write()
        except OSError as error:
            self._broken = error  # the library has lost count: nothing more can be written with it
            self._output.cut(self._whole_until)  # never half a chunk
            raise

    def _chunk_is_written(self) -> None:
        self._chunks += 1
        self._gathered_bytes = self._gathered = 0
        self._whole_until = self._output.tell()

    def _channel(self, key: str, message: type[Message], metadata: Mapping[str, str]) -> int:
        if key not in self._channels:
            name = message.DESCRIPTOR.full_name
            if name not in self._schemas:
                data = descriptor_set([message]).SerializeToString()
                self._schema_bytes += 2 * len(data)  # in the chunk and in the index
                self._schemas[name] = self._writer.register_schema(name, SchemaEncoding.Protobuf, data)
            self._channels[key] = self._writer.register_channel(
                key, MessageEncoding.Protobuf, self._schemas[name], {"encoding": encoding_of(message), **metadata}
            )
        return self._channels[key]
