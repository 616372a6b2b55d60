"""The framing of MCAP: records of one byte opcode, eight bytes length, content.

Nothing that a file says about sizes is believed: a length is compared with what is there before it is used.
Format: https://mcap.dev/spec
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk

MAGIC = b"\x89MCAP0\r\n"
HEADER_SIZE = 9  # [bytes] opcode and length
LARGEST_CHUNK = 2**29  # [bytes] decompressed; rosbag2's chunks have 0.75 to 4 MiB

# What parsing a damaged record can raise, from the mcap library, struct and the decompressors.
DAMAGE = (McapError, struct.error, ValueError, EOFError, RuntimeError, zstandard.ZstdError)

_HEADER = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time


class Frame(NamedTuple):
    """Where a record's content stands."""

    opcode: int
    start: int  # [bytes] first byte of the content
    stop: int  # [bytes] one after its last


class Message(NamedTuple):
    """A message, not yet assigned to its channel."""

    log_time: int  # [ns]
    publish_time: int  # [ns]
    channel: int
    data: bytes


def frames_of_file(file: BinaryIO, start: int, size: int) -> Iterator[Frame]:
    """Frames from byte `start` on, as long as they are complete; ends quietly where they aren't any more."""
    position = start
    while position + HEADER_SIZE <= size:
        file.seek(position)
        opcode, length = _HEADER.unpack(file.read(HEADER_SIZE))
        content = position + HEADER_SIZE
        if opcode == 0 or length > size - content:  # 0 is not an opcode
            return
        yield Frame(opcode, content, content + length)
        position = content + length


def frames_in(data: bytes) -> Iterator[Frame]:
    """Frames of the content of a chunk. ValueError if they don't fill it."""
    position, size = 0, len(data)
    while position < size:
        opcode, length = _HEADER.unpack_from(data, position)
        position += HEADER_SIZE
        if opcode == 0 or length > size - position:
            raise ValueError(f"record of {length} bytes at {position} of {size}")
        yield Frame(opcode, position, position + length)
        position += length


def messages_in(data: bytes) -> Iterator[Message]:
    """Messages of the content of a chunk, in the order in which they were written."""
    for opcode, start, stop in frames_in(data):
        if opcode == Opcode.MESSAGE:
            yield message_at(data, start, stop)


def message_at(data: bytes, start: int, stop: int) -> Message:
    """The message between two places. ValueError if it is too short to be one."""
    if stop - start < _MESSAGE.size:
        raise ValueError(f"message record of {stop - start} bytes")
    channel, _, log_time, publish_time = _MESSAGE.unpack_from(data, start)
    return Message(log_time, publish_time, channel, data[start + _MESSAGE.size : stop])


def content_of(file: BinaryIO, frame: Frame) -> bytes:
    """Content of a record. ValueError if it is larger than anything that a recorder writes."""
    if frame.stop - frame.start > LARGEST_CHUNK:
        raise ValueError(f"record of {frame.stop - frame.start} bytes")
    file.seek(frame.start)
    return file.read(frame.stop - frame.start)


def stream_of(data: bytes) -> ReadDataStream:
    """The form in which the mcap library takes a record's content."""
    return ReadDataStream(BytesIO(data))


def chunk_content(record: bytes) -> bytes:
    """Decompressed content of a chunk record. One of DAMAGE if its size or its checksum is wrong."""
    chunk = Chunk.read(stream_of(record))
    size = chunk.uncompressed_size
    if size > LARGEST_CHUNK:
        raise ValueError(f"chunk of {size} bytes")
    if chunk.compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
            data = reader.read(size + 1)  # not more, whatever the compressed data hold
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"unknown compression {chunk.compression!r}")
    if len(data) != size:
        raise ValueError(f"chunk of {len(data)} bytes instead of {size}")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("wrong checksum of a chunk")
    return data
