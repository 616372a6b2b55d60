"""How a bag's file is packed: rosbag2's storage presets, and a default of our own.

rosbag2_storage_mcap, docs of `--storage-preset-profile`.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Any, BinaryIO

import zstandard
from mcap.records import Chunk, ChunkIndex
from mcap.writer import CompressionType, Writer

_LIBRARY_LEVEL = 3  # of zstandard.compress, which the library's writer calls


@dataclass(frozen=True)
class Preset:
    """A way to pack."""

    meaning: str
    zstd_level: int | None  # None: not compressed
    chunk_size: int = 2**20  # [bytes]; 0: messages stand outside chunks
    checksums: bool = True


PRESETS = {
    "zstd": Preset("zstd at its usual level, chunks of 1 MiB", _LIBRARY_LEVEL),
    "none": Preset("chunks of 768 KiB, not compressed: rosbag2's default", None, 786432),
    "fastwrite": Preset("neither chunks nor checksums: the least work, and no index", None, 0, False),
    "zstd_fast": Preset("zstd at its fastest level, no checksums", -5, 786432, False),
    "zstd_small": Preset(
        "zstd at its slowest level, chunks of 4 MiB: minutes of work for an hour", 19, 2**22
    ),
}


def make_writer(file: BinaryIO, preset: Preset) -> Any:
    """A writer of the mcap library that packs so."""
    compressed = preset.zstd_level is not None
    kind = Writer if preset.zstd_level in (None, _LIBRARY_LEVEL) else _LeveledWriter
    writer = kind(
        file,
        chunk_size=preset.chunk_size,
        compression=CompressionType.ZSTD if compressed else CompressionType.NONE,
        use_chunking=preset.chunk_size > 0,
        enable_crcs=preset.checksums,
    )
    if isinstance(writer, _LeveledWriter):
        writer.level, writer.checksums = preset.zstd_level, preset.checksums
    return writer


class _LeveledWriter(Writer):
    """The library's writer with a level of compression, which it doesn't let one choose.

    Overrides the one method that compresses, by its mangled name; a test sees to it that levels differ in
    what is written.
    """

    level: int | None = None
    checksums = True

    def _Writer__finalize_chunk(self) -> None:
        of: Any = self
        builder = of._Writer__chunk_builder
        if not builder or builder.num_messages == 0:
            return
        data = builder.end()
        packed = zstandard.ZstdCompressor(level=self.level or 0).compress(data)
        chunk = Chunk(
            compression="zstd",
            data=packed,
            message_start_time=builder.message_start_time,
            message_end_time=builder.message_end_time,
            uncompressed_crc=zlib.crc32(data) if self.checksums else 0,
            uncompressed_size=len(data),
        )
        of._Writer__flush()
        start = of._Writer__stream.tell()
        chunk.write(of._Writer__record_builder)
        length = of._Writer__record_builder.count
        of._Writer__flush()
        index_start, offsets = of._Writer__stream.tell(), {}
        for channel, index in builder.message_indices.items():
            offsets[channel] = index_start + of._Writer__record_builder.count
            index.write(of._Writer__record_builder)
        of._Writer__statistics.chunk_count += 1
        of._Writer__chunk_indices.append(
            ChunkIndex(
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                chunk_start_offset=start,
                chunk_length=length,
                message_index_offsets=offsets,
                message_index_length=of._Writer__record_builder.count,
                compression="zstd",
                compressed_size=len(packed),
                uncompressed_size=len(data),
            )
        )
        of._Writer__flush()
        builder.reset()
