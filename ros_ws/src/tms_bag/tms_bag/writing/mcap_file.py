"""One MCAP file of a bag, as rosbag2 lays it out, while it is written."""

from __future__ import annotations

import os
from pathlib import Path
from threading import Lock
from typing import Any, BinaryIO

from tms_bag.channel import Channel
from tms_bag.record import Record
from tms_bag.writing.presets import Preset, make_writer

LIBRARY = "tms_bag"
MESSAGE_OVERHEAD = 31 + 16  # [bytes] of a message in a chunk beside its data: record and index


class McapFile:
    """A file that is being written. OSError when the system doesn't take what is written.

    Nothing more is written then: part of a chunk may be missing, and what came after it would make the file
    look whole.
    """

    def __init__(self, path: Path, preset: Preset) -> None:
        self.path = path
        self.message_count = 0
        self.time_range: tuple[int, int] | None = None  # earliest and latest log time [ns]
        self._chunked = preset.chunk_size > 0
        self.failure: OSError | None = None  # of the system, while something was written
        self._closing = Lock()  # a descriptor that is closed may be another file's a moment later
        self._pending = 0  # [bytes] in the chunk that isn't complete yet
        self._channels: dict[str, int] = {}
        self._schemas: dict[tuple[str, bytes], int] = {}
        self._file: BinaryIO = path.open("wb")
        self._mcap: Any = make_writer(self._file, preset)
        self._mcap.start(profile="ros2", library=LIBRARY)

    @property
    def largest_size(self) -> int:
        """Size that the file has, or could get with what waits in the open chunk [bytes]."""
        return self._file.tell() + self._pending

    def add_channel(self, channel: Channel) -> None:
        """Announce a topic."""
        key = (channel.type, channel.schema)
        if key not in self._schemas:
            self._schemas[key] = self._mcap.register_schema(
                channel.type, channel.schema_encoding, channel.schema
            )
            self._pending += len(channel.schema)
        self._channels[channel.name] = self._mcap.register_channel(
            channel.name, channel.encoding, self._schemas[key], channel.metadata
        )

    def write(self, record: Record) -> None:
        """Append a message of an announced topic."""
        sent = record.time_ns if record.publish_time_ns is None else record.publish_time_ns
        try:
            self._mcap.add_message(self._channels[record.topic], record.time_ns, record.data, sent)
        except OSError as error:
            self.failure = error
            raise
        if self._chunked:
            self._pending += len(record.data) + MESSAGE_OVERHEAD
        self.message_count += 1
        start, end = self.time_range or (record.time_ns, record.time_ns)
        self.time_range = (min(start, record.time_ns), max(end, record.time_ns))

    def add_metadata(self, text: str) -> None:
        """Append what rosbag2 keeps about the bag inside the file."""
        self._mcap.add_metadata("rosbag2", {"serialized_metadata": text})

    def flush(self) -> None:
        """Complete the chunk and hand everything to the operating system: a kill can't take it back."""
        try:
            self._mcap.flush()
        except OSError as error:
            self.failure = error
            raise
        self._pending = 0

    def sync(self) -> None:
        """Bring what has been flushed to the disk. May be called from another thread, and take long."""
        with self._closing:
            if self._file.closed:  # it has been finished meanwhile, and is on the disk
                return
            handle = os.dup(self._file.fileno())
        try:
            os.fsync(handle)
        except OSError as error:
            self.failure = error
            raise
        finally:
            os.close(handle)

    def finish(self, text: str) -> None:
        """Write metadata and summary, bring all to the disk, close. OSError if something was not taken."""
        if self.failure:
            raise self.failure
        self.add_metadata(text)
        self._mcap.finish()
        self._file.flush()
        os.fsync(self._file.fileno())  # the name of a finished bag must not come before its content
        with self._closing:
            self._file.close()

    def abandon(self) -> None:
        """Close the file as it is."""
        try:
            self._file.close()
        except OSError:  # the disk is full, which has been told already
            self._file.close()
