"""Bags written: rosbag2's MCAP files and their metadata.yaml.

The same records and the same custom data give the same bytes: no wall clock and no version of a library gets
in.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from tms_bag import metadata
from tms_bag.channel import Channel, installed_channel
from tms_bag.errors import RecordingError
from tms_bag.qos import SENSOR, Qos
from tms_bag.record import Record
from tms_bag.writing.folder import Destination, sync_folder, write_at_once
from tms_bag.writing.mcap_file import McapFile
from tms_bag.writing.presets import PRESETS

LAST_TIME_NS = 2**63 - 1
SUMMARY_SHARE = 0.02  # of a file's size limit, kept for its summary
LEAST_CHUNK = 4096  # [bytes] below this a file near its limit is not filled any further


@dataclass(frozen=True)
class Splitting:
    """When a bag goes on in another file; 0: never for this reason."""

    size: int = 0  # [bytes] that a file has at most, if a single message and the summary allow it
    duration_ns: int = 0  # [ns] between the first and the last log time of a file


NEVER = Splitting()


class BagWriter:
    """Writes a bag; use it as a context manager.

    Written beside `path` and renamed to it at a clean end: after an exception nothing is left; RecordingError
    where the system takes no more. With `live` it is written in place, and kept as far as it got whatever
    happens: OSError where the system takes no more; `flush` bounds what can be lost.
    RecordingError if `path` exists; with `overwrite` a bag of .mcap files, and nothing else, is replaced,
    with `keep_old_as` whatever is there is moved to that path. `preset` is one of PRESETS. `beside` is called
    when the bag is complete, before it stands at `path`, while nothing else does: whatever belongs beside a
    bag is there before the bag is. If it raises, all is as it was before.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        custom_data: Mapping[str, str] | None = None,
        overwrite: bool = False,
        live: bool = False,
        keep_old_as: Path | None = None,
        preset: str = "zstd",
        splitting: Splitting = NEVER,
        beside: Callable[[], None] | None = None,
    ) -> None:
        self.path = Path(path)
        self.custom_data = dict(custom_data or {})
        self.live = live
        if preset not in PRESETS:
            raise RecordingError(f"compression: expected one of {', '.join(PRESETS)}, found {preset!r}")
        self._preset, self._splitting = PRESETS[preset], splitting
        self._destination = Destination(
            self.path, overwrite=overwrite, in_place=live, keep_old_as=keep_old_as
        )
        self._beside = beside
        self._channels: dict[str, Channel] = {}
        self._counts: dict[str, int] = {}
        self._files: list[metadata.FileInformation] = []  # those that are finished

    @property
    def counts(self) -> dict[str, int]:
        """Messages written so far, by topic."""
        return dict(self._counts)

    @property
    def file_count(self) -> int:
        """Files begun so far."""
        return len(self._files) + 1

    def __enter__(self) -> BagWriter:
        self._folder = self._destination.create()
        try:
            self._file = self._next_file()
        except BaseException as error:
            self._destination.discard()
            self._tell_if_refused(error)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is not None and not self.live:
            self._file.abandon()
            self._destination.discard()
            if error is self._file.failure:
                self._tell_if_refused(error)
            return
        try:
            self._finish_file()
            text = metadata.to_text({metadata.ROOT: self._information()})
            write_at_once(self._folder / metadata.FILE_NAME, text)
        except BaseException as error:
            self._file.abandon()
            if not self.live:
                self._destination.discard()
                self._tell_if_refused(error)
            raise
        self._destination.keep(self._beside)

    def add_channel(self, channel: Channel) -> None:
        """Announce a topic. Without messages it stands in the bag with a count of 0."""
        if channel.name in self._channels:
            raise ValueError(f"topic {channel.name} has been added already")
        self._file.add_channel(channel)
        self._channels[channel.name] = channel
        self._counts[channel.name] = 0

    def write(self, record: Record, qos: Qos = SENSOR) -> None:
        """Append a message; the first one of a topic decides the topic's type and quality of service."""
        if record.topic not in self._channels:
            self.add_channel(installed_channel(record.topic, record.type, (qos,)))
        channel = self._channels[record.topic]
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
        if self._splitting != NEVER and self._has_no_room_for(record):
            self.split()
        self._file.write(record)
        self._counts[record.topic] += 1

    def split(self) -> None:
        """Go on in another file, unless the present one is empty."""
        if self._file.message_count:
            self._finish_file()
            self._file = self._next_file()

    def flush(self) -> None:
        """Complete the chunk and hand everything to the operating system: a kill can't take it back."""
        self._file.flush()

    def sync(self) -> None:
        """Bring what has been flushed to the disk: a power failure can't take it back. May take long.

        May be called from another thread.
        """
        self._file.sync()

    def _has_no_room_for(self, record: Record) -> bool:
        file, limit = self._file, self._splitting
        if limit.duration_ns and file.time_range:
            earliest, _ = file.time_range
            if record.time_ns - earliest > limit.duration_ns:
                return True
        room = round(limit.size * (1.0 - SUMMARY_SHARE)) - len(record.data)
        if limit.size and file.largest_size > room:
            file.flush()  # compressed it may be smaller
            return file.largest_size > room - min(LEAST_CHUNK, limit.size // 10)
        return False

    def _next_file(self) -> McapFile:
        name = f"{self._destination.name}_{len(self._files)}.mcap"
        file = McapFile(self._folder / name, self._preset)
        if self.live:  # an unfinished file says what it is, too
            file.add_metadata(metadata.to_text(self._information(file)))
            file.flush()
            sync_folder(self._folder)
        for channel in self._channels.values():
            file.add_channel(channel)
        return file

    def _finish_file(self) -> None:
        self._file.finish(metadata.to_text(self._information(self._file)))
        self._files.append(_information_of(self._file))

    def _tell_if_refused(self, error: BaseException | None) -> None:
        """RecordingError instead of what the system says, which doesn't name the bag."""
        if isinstance(error, OSError):
            raise RecordingError(
                f"{self.path}: can't be written ({error.strerror}), and nothing of it is left; make room or"
                " choose another place for the bag"
            ) from error

    def _information(self, current: McapFile | None = None) -> dict[str, Any]:
        files = self._files + ([_information_of(current)] if current else [])
        return metadata.bag_information(
            files, list(self._channels.values()), list(self._counts.values()), self.custom_data
        )


def _information_of(file: McapFile) -> metadata.FileInformation:
    return metadata.FileInformation(file.path.name, file.time_range, file.message_count)
