"""Bags read: a folder with rosbag2's MCAP files, or one .mcap file, finished or not."""

from __future__ import annotations

import heapq
import os
from collections.abc import Collection, Iterator
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, NamedTuple

from tms_bag import metadata
from tms_bag.channel import ENCODING, Channel
from tms_bag.errors import RecordingError
from tms_bag.frames import DAMAGE, MAGIC
from tms_bag.index import FileIndex, Span, index_file, scan, span_messages
from tms_bag.record import Record


class Topic(NamedTuple):
    """A topic of a bag."""

    name: str
    type: str
    count: int  # type: ignore[assignment]  # messages; hides tuple.count, which nobody needs here


class BagReader:
    """Reads a bag; use it as a context manager. RecordingError if `path` holds nothing readable.

    With `salvage` everything that can be read is, whatever the summaries and the metadata.yaml say: damaged
    parts are left out, `indexes` tell how much that was.
    """

    def __init__(self, path: str | os.PathLike[str], salvage: bool = False) -> None:
        self.path = Path(path)
        self.salvage = salvage
        files, stored = _files_of(self.path, salvage)
        self._files: list[BinaryIO] = []
        self._indexes: list[FileIndex] = []
        try:
            for name in files:
                self._open(name, alone=len(files) == 1)
        except BaseException:
            self.close()
            raise
        in_files: dict[str, str] = {}
        for index in self._indexes:
            in_files.update(index.custom_data)
        self.custom_data = stored.custom_data if stored and stored.custom_data else in_files
        listed = stored is not None or self.path.is_file()
        self.complete = listed and all(index.complete for index in self._indexes)

    def __enter__(self) -> BagReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        while self._files:
            self._files.pop().close()

    @property
    def topics(self) -> list[Topic]:
        """Topics with their types and message counts, by name."""
        counts: dict[tuple[str, str], int] = {}
        for index in self._indexes:
            for number, channel in index.channels.items():
                key = (channel.name, channel.type)
                counts[key] = counts.get(key, 0) + index.counts.get(number, 0)
        return [Topic(name, type_name, count) for (name, type_name), count in sorted(counts.items())]

    @property
    def channels(self) -> list[Channel]:
        """What the bag says about each topic, once per topic and type, in the order of the files."""
        found: dict[tuple[str, str], Channel] = {}
        for index in self._indexes:
            for channel in index.channels.values():
                found.setdefault((channel.name, channel.type), channel)
        return list(found.values())

    @property
    def indexes(self) -> list[FileIndex]:
        """What is where, file by file."""
        return list(self._indexes)

    @property
    def message_count(self) -> int:
        """Messages of all topics together."""
        return sum(topic.count for topic in self.topics)

    @property
    def start_ns(self) -> int:
        """Log time of the first message [ns]; 0 without messages."""
        return min((index.time_range[0] for index in self._indexes if index.time_range), default=0)

    @property
    def end_ns(self) -> int:
        """Log time of the last message [ns]; 0 without messages."""
        return max((index.time_range[1] for index in self._indexes if index.time_range), default=0)

    def records(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[Record]:
        """Messages in the order of log time, from `start_ns` up to but not including `stop_ns`.

        At equal times in the order in which they were written. RecordingError if a message can't be read, or
        if `topics` asks for one that isn't there.
        """
        first = 0 if start_ns is None else start_ns
        last = 2**64 if stop_ns is None else stop_ns
        if topics is not None:
            self._check_topics(topics)
        spans = [
            (span.start_ns, file_number, span.frame.start, span)
            for file_number, index in enumerate(self._indexes)
            for span in index.spans
            if span.start_ns < last and span.end_ns >= first
        ]
        pending: list[tuple[int, int, int, int, Record]] = []
        for span_start, file_number, place, span in sorted(spans, key=lambda entry: entry[:3]):
            while pending and pending[0][0] < span_start:
                yield heapq.heappop(pending)[-1]
            for order, record in enumerate(self._span_records(file_number, span, topics)):
                if first <= record.time_ns < last:
                    heapq.heappush(pending, (record.time_ns, file_number, place, order, record))
        while pending:
            yield heapq.heappop(pending)[-1]

    def _span_records(self, file_number: int, span: Span, topics: Collection[str] | None) -> Iterator[Record]:
        file, channels = self._files[file_number], self._indexes[file_number].channels
        try:
            messages = span_messages(file, span)
        except DAMAGE as error:
            raise RecordingError(
                f"{self.path}: the part that starts at byte {span.frame.start} is damaged ({error});"
                f" `tms bag repair {self.path} -o NEW` saves the rest"
            ) from error
        for message in messages:
            channel = channels.get(message.channel)
            if channel is None or (topics is not None and channel.name not in topics):
                continue
            if channel.encoding != ENCODING and not self.salvage:
                raise RecordingError(
                    f"{self.path}: expected messages in ROS 2's encoding {ENCODING}, found"
                    f" {channel.encoding!r} on"
                    f" {channel.name}; choose topics without it"
                )
            yield Record(channel.name, channel.type, message.log_time, message.data, message.publish_time)

    def _check_topics(self, topics: Collection[str]) -> None:
        there = {topic.name for topic in self.topics}
        missing = sorted(set(topics) - there)
        if missing:
            raise RecordingError(
                f"{self.path}: no topic {', '.join(missing)}; there are: {', '.join(sorted(there)) or 'none'}"
            )

    def _open(self, path: Path, alone: bool) -> None:
        try:
            file = path.open("rb")
        except OSError as error:
            raise RecordingError(f"{path}: can't be opened ({error.strerror})") from error
        self._files.append(file)
        size = os.fstat(file.fileno()).st_size
        magic = file.read(len(MAGIC))
        if magic != MAGIC and self.salvage and not alone:
            self._indexes.append(FileIndex(unread_bytes=size))  # the other files may hold something
            return
        if magic != MAGIC:
            found = "an empty file" if size == 0 else f"{size} bytes that start with {magic!r}"
            raise RecordingError(
                f"{path}: expected an MCAP file, found {found}; there is nothing to read in it"
            )
        self._indexes.append(scan(file, size) if self.salvage else index_file(file, size))


def _files_of(path: Path, salvage: bool) -> tuple[list[Path], metadata.Metadata | None]:
    """The MCAP files of a bag, and its metadata.yaml if it has one (that can be read, for `salvage`)."""
    if path.is_file():
        return [path], None
    if not path.is_dir():
        found = "something that isn't a file" if path.exists() else "nothing there"
        raise RecordingError(
            f"{path}: expected a bag (a folder) or an .mcap file, found {found}; check the path"
        )
    stored = _stored_metadata(path, salvage)
    if stored and not salvage:
        return [_inside(path, name) for name in stored.files], stored
    names = sorted((entry.name for entry in path.iterdir() if entry.suffix == ".mcap"), key=_split_number)
    if not names:
        entries = sorted(entry.name for entry in path.iterdir())[:5]
        raise RecordingError(
            f"{path}: expected a bag with metadata.yaml or .mcap files, found"
            f" {', '.join(entries) or 'an empty folder'};"
            " give the folder that `bag record`, `sim run` or `ros2 bag record -s mcap` made"
        )
    return [_inside(path, name) for name in names], stored


def _stored_metadata(path: Path, salvage: bool) -> metadata.Metadata | None:
    if not (path / metadata.FILE_NAME).is_file():
        return None
    try:
        return metadata.read_file(path / metadata.FILE_NAME)
    except RecordingError:
        if salvage:
            return None
        raise


def _inside(folder: Path, name: str) -> Path:
    """A file of the bag; RecordingError if it is missing or a link leads out of the folder."""
    path = folder / name
    if path.resolve().parent != folder.resolve():
        raise RecordingError(
            f"{path}: expected a file in the folder of the bag, found a link to elsewhere: not opened"
        )
    if not path.is_file():
        raise RecordingError(
            f"{path}: metadata.yaml names this file, but it isn't there; bring it back, or `tms bag repair`"
        )
    return path


def _split_number(name: str) -> tuple[str, int]:
    """Files in the order in which a recorder split them: bag_2 before bag_10."""
    stem, _, number = name.removesuffix(".mcap").rpartition("_")
    return (stem, int(number)) if number.isdecimal() else (name, -1)
