"""The framing of MCAP: records of one byte opcode, eight bytes length, content.

Nothing that a file says about sizes is believed: a length is compared with what is there before it is used.
Format: https://mcap.dev/spec
"""

from __future__ import annotations

import os
import struct
import zlib
from io import BytesIO
from typing import BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Chunk

MAGIC = b"\x89MCAP0\r\n"
HEADER_SIZE = 9  # [bytes] opcode and length
LARGEST_CHUNK = 2**26  # [bytes] decompressed; rosbag2's chunks have 0.75 to 4 MiB
LARGEST_WINDOW = 2**27  # [bytes] of memory that zstd may ask for; its levels up to 22 take no more

# What reading a damaged record can raise: the mcap library, struct, the decompressors, a disk that fails.
DAMAGE = (
    *(McapError, struct.error, ValueError, EOFError, RuntimeError, OverflowError),
    *(zstandard.ZstdError, OSError),
)

LARGEST_RECORD = LARGEST_CHUNK + 2**16  # [bytes] a chunk that is not compressed, and its head

_HEADER = struct.Struct("<BQ")


class Frame(NamedTuple):
    """Where a record's content stands."""

    opcode: int
    start: int  # [bytes] first byte of the content
    stop: int  # [bytes] one after its last


def frame_at(file: BinaryIO, place: int, size: int) -> Frame | None:
    """The record that starts at a place of a file; None if no complete one does."""
    head = os.pread(file.fileno(), HEADER_SIZE, place)
    if len(head) < HEADER_SIZE:
        return None
    opcode, length = _HEADER.unpack(head)
    start = place + HEADER_SIZE
    if opcode == 0 or length > size - start:  # 0 is not an opcode
        return None
    return Frame(opcode, start, start + length)


def content_of(file: BinaryIO, frame: Frame) -> bytes:
    """Content of a record. ValueError if it is larger than anything that a recorder writes, or cut off."""
    size = frame.stop - frame.start
    if size > LARGEST_RECORD:
        raise ValueError(f"record of {size} bytes, more than {LARGEST_RECORD}")
    data = os.pread(file.fileno(), size, frame.start)  # leaves the file's place to whoever else reads it
    if len(data) != size:
        raise ValueError(f"{len(data)} bytes instead of {size}: the file has become shorter")
    return data


def stream_of(data: bytes) -> ReadDataStream:
    """The form in which the mcap library takes a record's content."""
    return ReadDataStream(BytesIO(data))


def chunk_content(record: bytes) -> bytes:
    """Decompressed content of a chunk record. One of DAMAGE if its size or its checksum is wrong."""
    chunk = Chunk.read(stream_of(record))
    size = chunk.uncompressed_size
    if size > LARGEST_CHUNK:
        raise ValueError(f"chunk of {size} bytes, more than {LARGEST_CHUNK}")
    if chunk.compression == "zstd":
        data = _unpacked_zstd(chunk.data, size)
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


def _unpacked_zstd(packed: bytes, size: int) -> bytes:
    """At most one byte more than `size`, whatever the compressed data say of themselves or hold."""
    if not packed:  # of nothing, which some writers don't pack
        return b""
    if zstandard.frame_content_size(packed) == size:
        return zstandard.ZstdDecompressor().decompress(packed)
    with zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True) as reader:
        return reader.read(size + 1)
