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
_CHUNK_HEAD = struct.Struct("<QQQII")  # times, unpacked size, checksum, length of the compression's name
_LENGTH = struct.Struct("<Q")


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


class ChunkHead(NamedTuple):
    """What stands before the data of a chunk."""

    start_ns: int  # earliest log time
    end_ns: int  # latest
    size: int  # [bytes] unpacked
    checksum: int  # of what is unpacked; 0: none
    compression: bytes
    data_start: int  # [bytes] where the data start in the record
    data_size: int  # [bytes] of the data, packed


def chunk_head(record: bytes) -> ChunkHead:
    """Head of a chunk record. struct.error or ValueError if it has none."""
    start_ns, end_ns, size, checksum, name_size = _CHUNK_HEAD.unpack_from(record)
    name_end = _CHUNK_HEAD.size + name_size
    (data_size,) = _LENGTH.unpack_from(record, name_end)
    name = record[_CHUNK_HEAD.size : name_end]
    return ChunkHead(start_ns, end_ns, size, checksum, name, name_end + _LENGTH.size, data_size)


def chunk_content(record: bytes) -> tuple[bytes, int]:
    """Unpacked content of a chunk record, and where in these bytes it starts.

    One of DAMAGE if its size or its checksum is wrong.
    """
    head = chunk_head(record)
    size, start, stop = head.size, head.data_start, head.data_start + head.data_size
    if size > LARGEST_CHUNK:
        raise ValueError(f"chunk of {size} bytes, more than {LARGEST_CHUNK}")
    if stop > len(record):
        raise ValueError(f"{len(record) - start} bytes instead of {head.data_size}")
    if head.compression == b"":
        content = record if stop == len(record) else record[:stop]  # a copy takes as long as the checksum
    elif head.compression == b"zstd":
        content, start = _unpacked_zstd(record[start:stop], size), 0
    elif head.compression == b"lz4":
        decompressor = lz4.frame.LZ4FrameDecompressor()
        content, start = decompressor.decompress(record[start:stop], max_length=size + 1), 0
    else:
        raise ValueError(f"unknown compression {head.compression[:20]!r}")
    if len(content) - start != size:
        raise ValueError(f"chunk of {len(content) - start} bytes instead of {size}")
    if head.checksum not in (0, zlib.crc32(memoryview(content)[start:])):
        raise ValueError("wrong checksum of a chunk")
    return content, start


def _unpacked_zstd(packed: bytes, size: int) -> bytes:
    """At most one byte more than `size`, whatever the compressed data say of themselves or hold."""
    if not packed:  # of nothing, which some writers don't pack
        return b""
    if zstandard.frame_content_size(packed) == size:
        return zstandard.ZstdDecompressor().decompress(packed)
    with zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True) as reader:
        return reader.read(size + 1)
