"""Bags written: rosbag2's MCAP files and their metadata.yaml.

The same records and the same custom data give the same bytes: no wall clock and no version of a library gets
in.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

from mcap.writer import CompressionType, Writer

from tms_bag import metadata
from tms_bag.channel import Channel, installed_channel
from tms_bag.errors import RecordingError
from tms_bag.folder import Destination
from tms_bag.qos import SENSOR, Qos
from tms_bag.record import Record

CHUNK_SIZE = 2**20  # [bytes]
LAST_TIME_NS = 2**63 - 1
LIBRARY = "tms_bag"


class BagWriter:
    """Writes a bag; use it as a context manager.

    Written beside `path` and renamed to it at a clean end: after an exception nothing is left. With `live` it
    is written in place, and kept as far as it got whatever happens; `flush` then bounds what can be lost.
    RecordingError if `path` exists; with `overwrite` an existing bag (and nothing but a bag) is replaced,
    with `keep_old_as` whatever is there is moved to that path.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        custom_data: Mapping[str, str] | None = None,
        overwrite: bool = False,
        live: bool = False,
        keep_old_as: Path | None = None,
    ) -> None:
        self.path = Path(path)
        self.custom_data = dict(custom_data or {})
        self.live = live
        self._destination = Destination(
            self.path, overwrite=overwrite, in_place=live, keep_old_as=keep_old_as
        )
        self._channels: dict[str, tuple[int, Channel]] = {}
        self._schemas: dict[tuple[str, bytes], int] = {}
        self._counts: dict[str, int] = {}
        self._time_range: tuple[int, int] | None = None

    @property
    def counts(self) -> dict[str, int]:
        """Messages written so far, by topic."""
        return dict(self._counts)

    def __enter__(self) -> BagWriter:
        self._folder = self._destination.create()
        self._file: BinaryIO = (self._folder / self._file_name).open("wb")
        self._mcap: Any = Writer(self._file, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
        self._mcap.start(profile="ros2", library=LIBRARY)
        if self.live:
            self._add_metadata_record()  # an unfinished file says what it is, too
            self.flush()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is not None and not self.live:
            self._file.close()
            self._destination.discard()
            return
        try:
            self._finish()
        except BaseException:
            self._file.close()
            if not self.live:
                self._destination.discard()
            raise
        self._destination.keep()

    def add_channel(self, channel: Channel) -> None:
        """Announce a topic. Without messages it stands in the bag with a count of 0."""
        if channel.name in self._channels:
            raise ValueError(f"topic {channel.name} has been added already")
        key = (channel.type, channel.schema)
        if key not in self._schemas:
            self._schemas[key] = self._mcap.register_schema(
                channel.type, channel.schema_encoding, channel.schema
            )
        channel_id = self._mcap.register_channel(
            channel.name, channel.encoding, self._schemas[key], channel.metadata
        )
        self._channels[channel.name] = (channel_id, channel)
        self._counts[channel.name] = 0

    def write(self, record: Record, qos: Qos = SENSOR) -> None:
        """Append a message; the first one of a topic decides the topic's type and quality of service."""
        if record.topic not in self._channels:
            self.add_channel(installed_channel(record.topic, record.type, (qos,)))
        channel_id, channel = self._channels[record.topic]
        if channel.type != record.type:
            raise RecordingError(
                f"{self.path}: topic {record.topic} holds {channel.type}, found a message of type"
                f" {record.type};"
                " a topic has one type, rename one of the two"
            )
        if not 0 <= record.time_ns <= LAST_TIME_NS:
            raise RecordingError(
                f"{self.path}: expected times from 0 to 2^63 ns, found {record.time_ns} on {record.topic}"
            )
        sent = record.time_ns if record.publish_time_ns is None else record.publish_time_ns
        self._mcap.add_message(channel_id, record.time_ns, record.data, sent)
        self._counts[record.topic] += 1
        start, end = self._time_range or (record.time_ns, record.time_ns)
        self._time_range = (min(start, record.time_ns), max(end, record.time_ns))

    def flush(self) -> None:
        """Complete the chunk and hand everything to the operating system: a kill can't take it back."""
        self._mcap.flush()

    @property
    def _file_name(self) -> str:
        return f"{self._destination.name}_0.mcap"

    def _information(self) -> dict[str, Any]:
        return metadata.bag_information(
            self._file_name,
            [channel for _, channel in self._channels.values()],
            list(self._counts.values()),
            self._time_range,
            self.custom_data,
        )

    def _finish(self) -> None:
        self._add_metadata_record()
        self._mcap.finish()
        self._file.flush()
        os.fsync(self._file.fileno())  # the name of a finished bag must not come before its content
        self._file.close()
        text = metadata.to_text({metadata.ROOT: self._information()})
        (self._folder / metadata.FILE_NAME).write_text(text, encoding="utf-8")

    def _add_metadata_record(self) -> None:
        self._mcap.add_metadata("rosbag2", {"serialized_metadata": metadata.to_text(self._information())})
