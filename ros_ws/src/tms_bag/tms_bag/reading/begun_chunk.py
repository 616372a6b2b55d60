"""What can be had of a chunk whose end is missing: its recorder was killed, or the copy is cut short.

Nothing vouches for these bytes, since the checksum is of the whole chunk. So messages count as far as the
records are whole and their times are those that the chunk's head tells.
"""

from __future__ import annotations

import zlib
from dataclasses import replace

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard

from tms_bag.reading.block import Block, begun_block_of, within
from tms_bag.reading.frames import LARGEST_CHUNK, LARGEST_WINDOW, Frame, chunk_head

_PIECE = 2**14  # [bytes]
_NO_TIMES = {(0, 0), (2**64 - 1, 0)}  # of writers that fill them in when the chunk is complete


def begun_chunk(record: bytes) -> tuple[Block, list[Frame]]:
    """The messages of a chunk's record without its end, and other records in it. One of DAMAGE if none is."""
    head = chunk_head(record)
    content = _unpacked(head.compression, record[head.data_start :], min(head.size, LARGEST_CHUNK))
    if len(content) == head.size and head.checksum not in (0, zlib.crc32(content)):
        raise ValueError("wrong checksum of a chunk")
    block, others, _ = begun_block_of(content)
    if (head.start_ns, head.end_ns) in _NO_TIMES:
        return block, others
    wrong = np.flatnonzero(~within(block.log_time, head.start_ns, head.end_ns + 1))
    return _before(block, others, int(wrong[0])) if wrong.size else (block, others)


def _before(block: Block, others: list[Frame], row: int) -> tuple[Block, list[Frame]]:
    """What stands before a message."""
    place = int(block.start[row])
    fewer = {
        name: getattr(block, name)[:row] for name in ("start", "size", "channel", "log_time", "publish_time")
    }
    return replace(block, **fewer), [frame for frame in others if frame.start < place]


def _unpacked(compression: bytes, packed: bytes, most: int) -> bytes:
    if compression == b"":
        return packed[:most].rstrip(b"\0")  # what a power failure left of a page that wasn't written
    if compression == b"zstd":
        return _begun_zstd(packed, most)
    if compression == b"lz4":
        try:
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=most))
        except RuntimeError as error:
            raise ValueError(str(error)) from error
    raise ValueError(f"unknown compression {compression[:20]!r}")


def _begun_zstd(packed: bytes, most: int) -> bytes:
    found = bytearray()
    decompressor = zstandard.ZstdDecompressor(max_window_size=LARGEST_WINDOW)
    with decompressor.stream_reader(packed, read_across_frames=True) as reader:
        while len(found) < most:
            try:
                piece = reader.read(min(_PIECE, most - len(found)))
            except zstandard.ZstdError:
                break
            if not piece:
                break
            found += piece
    return bytes(found)
