"""Messages that rosbag2 packed one by one (`--compression-mode message`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import zstandard

from tms_bag.channel import ENCODING, Channel
from tms_bag.reading.block import Block
from tms_bag.reading.frames import LARGEST_CHUNK, LARGEST_WINDOW

MOST_UNPACKED = 2 * LARGEST_CHUNK  # [bytes] of one block
_MAGIC = b"\x28\xb5\x2f\xfd"  # of zstd; no CDR message starts so, whose first byte is 0


def with_messages_unpacked(block: Block, channels: Mapping[int, Channel]) -> Block:
    """The block, its messages unpacked if they are packed; the first one tells, since a bag is all one way.

    A message that can't be unpacked stays as it is.
    """
    if not block.size.size or block.data(0)[:4] != _MAGIC:
        return block
    channel = channels.get(int(block.channel[0]))
    if channel is None or channel.encoding != ENCODING:
        return block
    decompressor = zstandard.ZstdDecompressor(max_window_size=LARGEST_WINDOW)
    found, room = [], MOST_UNPACKED
    for row in range(block.size.size):
        data = _unpacked(decompressor, block.data(row), room)
        room -= len(data)
        found.append(data)
    size = np.array([len(data) for data in found], np.int64)
    return replace(block, content=b"".join(found), start=np.cumsum(size) - size, size=size)


def _unpacked(decompressor: zstandard.ZstdDecompressor, data: bytes, room: int) -> bytes:
    """What a message holds, if that isn't more than `room` bytes, whatever it says; else the message."""
    if data[:4] != _MAGIC:
        return data
    try:
        said = zstandard.frame_content_size(data)
        if said > room:
            return data
        if said >= 0:
            return decompressor.decompress(data)
        with decompressor.stream_reader(data) as reader:
            found = reader.read(max(room, 0) + 1)
        return found if len(found) <= room else data
    except zstandard.ZstdError:
        return data
