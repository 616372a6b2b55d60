"""What is where in an MCAP file: from its summary, or by going through the file where there is none.

A file that was closed properly ends with a summary. An unfinished one (its recorder was killed, its disk was
full) or a damaged one is read as far as its records are whole, the messages of a chunk that isn't complete
included; damaged chunks before that are left out and counted.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel as ChannelRecord
from mcap.records import ChunkIndex, Footer, Metadata, MetadataIndex, Schema, Statistics

from tms_bag.channel import Channel, stored_channel
from tms_bag.metadata import custom_data_of_record
from tms_bag.reading import frames
from tms_bag.reading.begun_chunk import begun_chunk
from tms_bag.reading.block import MESSAGE_HEAD, Block, begun_block_of, block_of
from tms_bag.reading.frames import DAMAGE, HEADER_SIZE, MAGIC, Frame

_FOOTER_SIZE = HEADER_SIZE + 20  # [bytes]
_WINDOW = 2**20  # [bytes] records outside chunks are looked at in portions of this size


@dataclass(frozen=True)
class Span:
    """A part of the file that holds messages: a chunk, or a run of records with messages outside chunks."""

    frame: Frame  # the chunk record; for loose messages the bytes they stand in
    start_ns: int  # earliest log time
    end_ns: int  # latest log time
    loose: bool
    channels: frozenset[int] | None = None  # those that have messages in it; None: not known
    begun: bool = False  # a chunk whose end is missing


@dataclass
class FileIndex:
    """Contents of one MCAP file."""

    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)  # messages by channel
    spans: list[Span] = field(default_factory=list)  # in file order
    custom_data: dict[str, str] = field(default_factory=dict)
    complete: bool = False  # closed properly
    damaged_chunks: int = 0
    unread_bytes: int = 0  # at the end, where no complete record stands any more
    saved: int = 0  # messages that stand in these bytes nevertheless, in a chunk whose end is missing

    @property
    def time_range(self) -> tuple[int, int] | None:
        """Earliest and latest log time [ns], None without messages."""
        if not self.spans:
            return None
        return min(span.start_ns for span in self.spans), max(span.end_ns for span in self.spans)


def index_file(file: BinaryIO, size: int) -> FileIndex:
    """Index of a file that starts with MCAP's magic bytes, by the quickest way that its state allows."""
    try:
        index = _from_summary(file, size)
    except DAMAGE:
        index = None
    return index if index else scan(file, size)


def _from_summary(file: BinaryIO, size: int) -> FileIndex | None:
    """Index from the summary; None if there is none, or none that tells everything."""
    footer_at = size - _FOOTER_SIZE - len(MAGIC)
    if footer_at < len(MAGIC):
        return None
    file.seek(footer_at)
    tail = file.read()
    if tail[-len(MAGIC) :] != MAGIC or tail[0] != Opcode.FOOTER:
        return None
    footer = Footer.read(frames.stream_of(tail[HEADER_SIZE : -len(MAGIC)]))
    if (
        not len(MAGIC) <= footer.summary_start < footer_at
        or footer_at - footer.summary_start > frames.LARGEST_CHUNK
    ):
        return None
    file.seek(footer.summary_start)
    summary = file.read(footer_at - footer.summary_start)
    checked = zlib.crc32(tail[: HEADER_SIZE + 16], zlib.crc32(summary))
    if footer.summary_crc not in (0, checked):
        return None
    builder = _Builder(file)
    statistics: list[Statistics] = []
    for frame in block_of(summary)[1]:
        content = summary[frame.start : frame.stop]
        if frame.opcode == Opcode.STATISTICS:
            statistics.append(Statistics.read(frames.stream_of(content)))
        elif frame.opcode == Opcode.CHUNK_INDEX:
            builder.add_chunk_index(ChunkIndex.read(frames.stream_of(content)), size)
        elif frame.opcode == Opcode.METADATA_INDEX:
            entry = MetadataIndex.read(frames.stream_of(content))
            builder.add_metadata(_record_at(file, entry.offset, size, Opcode.METADATA))
        else:
            builder.add_definition(frame.opcode, content)
    if len(statistics) != 1 or builder.messages_beside_chunks(footer.summary_start):
        return None
    return builder.index_with(statistics[0])


def scan(file: BinaryIO, size: int) -> FileIndex:
    """Index by going through the whole file."""
    builder, end, closed = _Builder(file), len(MAGIC), False
    while not closed:
        frame = frames.frame_at(file, end, size)
        if frame is None:
            break
        length = frame.stop - end
        if frame.opcode == Opcode.CHUNK or (length > _WINDOW and frame.opcode != Opcode.MESSAGE):
            others, stop = [frame], frame.stop
        elif length > frames.LARGEST_RECORD:
            others, stop = [], frame.stop
            builder.index.damaged_chunks += 1
        else:  # most records outside chunks are small: a window of the file holds many of them
            content = os.pread(file.fileno(), min(max(_WINDOW, length), size - end), end)
            others, stop = builder.add_loose(content, end)
        for other in others:
            builder.add_or_count(other)
            if other.opcode == Opcode.FOOTER:
                closed, stop = True, other.stop
                break
        end = stop
    index = builder.index
    if not closed:
        builder.add_begun_chunk(end, size)
    closed = closed and os.pread(file.fileno(), len(MAGIC) + 1, end) == MAGIC
    index.unread_bytes = 0 if closed else size - end
    index.complete = closed and index.damaged_chunks == 0
    return index


def _record_at(file: BinaryIO, offset: int, size: int, opcode: Opcode) -> bytes:
    """Content of the record at a place. ValueError if there is no such record."""
    frame = frames.frame_at(file, offset, size)
    if frame is not None and frame.opcode == opcode:
        return frames.content_of(file, frame)
    raise ValueError(f"no {opcode.name} record at byte {offset}")


class _Builder:
    """Collects an index record by record."""

    def __init__(self, file: BinaryIO) -> None:
        self.index = FileIndex()
        self._file = file
        self._schemas: dict[int, Schema] = {}
        self._chunks: list[tuple[int, int]] = []  # [bytes] from, to; of those in the summary

    def add_or_count(self, frame: Frame) -> None:
        """A record of the data section, but for messages; counted as damaged if it can't be read."""
        try:
            if frame.opcode == Opcode.CHUNK:
                self._add_chunk(frame)
            elif frame.opcode == Opcode.METADATA:
                self.add_metadata(frames.content_of(self._file, frame))
            elif frame.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.add_definition(frame.opcode, frames.content_of(self._file, frame))
            elif frame.opcode == Opcode.MESSAGE:
                raise ValueError("message too short")
        except DAMAGE:
            self.index.damaged_chunks += 1

    def add_begun_chunk(self, place: int, size: int) -> None:
        """The messages that can be had of a chunk at a place of the file, if its end is missing."""
        start = place + HEADER_SIZE
        if start >= size or os.pread(self._file.fileno(), 1, place) != bytes([Opcode.CHUNK]):
            return
        frame = Frame(Opcode.CHUNK, start, min(size, start + frames.LARGEST_RECORD))
        try:
            block, others = begun_chunk(frames.content_of(self._file, frame))
            for opcode, first, last in others:
                self.add_definition(opcode, block.content[first:last])
        except DAMAGE:
            return
        self._add_span(block, frame, loose=False, begun=True)
        self.index.saved = int(block.size.size)

    def add_loose(self, content: bytes, place: int) -> tuple[list[Frame], int]:
        """The messages outside chunks that stand at a place in the file.

        Returns the other records there, and the place where the complete records end.
        """
        block, others, stop = begun_block_of(content)
        self._add_span(block, Frame(Opcode.MESSAGE, place, place + stop), loose=True)
        moved = [Frame(opcode, place + start, place + end) for opcode, start, end in others]
        return moved, place + stop

    def add_definition(self, opcode: int, content: bytes) -> None:
        """A schema or a channel; anything else is left alone."""
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(frames.stream_of(content))
            self._schemas.setdefault(schema.id, schema)
        elif opcode == Opcode.CHANNEL:
            record = ChannelRecord.read(frames.stream_of(content))
            schema = self._schemas.get(record.schema_id) or Schema(id=0, data=b"", encoding="", name="")
            channel = stored_channel(
                record.topic,
                schema.name,
                record.metadata,
                schema.data,
                schema.encoding,
                record.message_encoding,
            )
            self.index.channels.setdefault(record.id, channel)

    def add_metadata(self, content: bytes) -> None:
        """A metadata record; of those of rosbag2 the last one counts."""
        record = Metadata.read(frames.stream_of(content))
        if record.name == "rosbag2":
            self.index.custom_data = custom_data_of_record(record.metadata.get("serialized_metadata", ""))

    def add_chunk_index(self, entry: ChunkIndex, size: int) -> None:
        """A chunk by its entry in the summary. ValueError if it isn't in the file."""
        start, stop = entry.chunk_start_offset + HEADER_SIZE, entry.chunk_start_offset + entry.chunk_length
        if not start <= stop <= size:
            raise ValueError(f"chunk from byte {start} to {stop} of {size}")
        self._chunks.append((entry.chunk_start_offset, stop + entry.message_index_length))
        if entry.message_index_offsets or entry.message_end_time:  # else there is no message in it
            frame = Frame(Opcode.CHUNK, start, stop)
            channels = frozenset(entry.message_index_offsets) or None  # empty: written without message index
            self.index.spans.append(
                Span(frame, entry.message_start_time, entry.message_end_time, loose=False, channels=channels)
            )
        elif entry.uncompressed_size >= HEADER_SIZE + MESSAGE_HEAD and not entry.message_index_length:
            raise ValueError("a chunk without message index, which may hold messages of time 0")

    def messages_beside_chunks(self, stop: int) -> bool:
        """Whether messages stand before byte `stop` that are in no chunk of the summary."""
        place = len(MAGIC)
        for start, end in [*sorted(self._chunks), (stop, stop)]:
            while place < start:
                frame = frames.frame_at(self._file, place, stop)
                if frame is None or frame.opcode in (Opcode.MESSAGE, Opcode.CHUNK):
                    return True
                place = frame.stop
            if place > start:
                return True  # they overlap: whoever made this summary isn't to be believed
            place = end
        return False

    def index_with(self, statistics: Statistics) -> FileIndex | None:
        """The index with the counts of the summary; None if the summary leaves something out."""
        counts = dict(statistics.channel_message_counts)
        known = (
            counts.keys() <= self.index.channels.keys() and sum(counts.values()) == statistics.message_count
        )
        indexed = statistics.chunk_count == len(self._chunks) and (
            self.index.spans or not statistics.message_count
        )
        if not (known and indexed and self._spans_tell(n for n, count in counts.items() if count)):
            return None
        self.index.counts = counts
        self.index.complete = True
        return self.index

    def _spans_tell(self, channels: Iterable[int]) -> bool:
        """Whether the chunks are said to hold messages of all these channels, and to end after they begin."""
        said: set[int] = set()
        for span in self.index.spans:
            if span.start_ns > span.end_ns:
                return False
            said |= self.index.channels.keys() if span.channels is None else span.channels
        return said.issuperset(channels)

    def _add_chunk(self, frame: Frame) -> None:
        block, others = block_of(*frames.chunk_content(frames.content_of(self._file, frame)))
        for opcode, start, stop in others:
            self.add_definition(opcode, block.content[start:stop])
        self._add_span(block, frame, loose=False)

    def _add_span(self, block: Block, frame: Frame, loose: bool, begun: bool = False) -> None:
        """Messages of a chunk or of a run of loose ones."""
        if not block.channel.size:
            return
        numbers, counts = (found.tolist() for found in np.unique(block.channel, return_counts=True))
        for number, count in zip(numbers, counts, strict=True):
            self.index.counts[number] = self.index.counts.get(number, 0) + count
        earliest, latest = int(block.log_time.min()), int(block.log_time.max())
        self.index.spans.append(Span(frame, earliest, latest, loose, frozenset(numbers), begun))


def block_at(file: BinaryIO, span: Span) -> Block:
    """Messages of a span. One of DAMAGE if they can't be read."""
    content = frames.content_of(file, span.frame)
    if span.begun:
        return begun_chunk(content)[0]
    return begun_block_of(content)[0] if span.loose else block_of(*frames.chunk_content(content))[0]
