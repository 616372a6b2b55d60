"""Bags read: a folder with rosbag2's MCAP files, or one .mcap file, finished or not."""

from __future__ import annotations

import heapq
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, NamedTuple

import numpy as np

from tms_bag import metadata
from tms_bag.advance import in_advance
from tms_bag.block import Block, within
from tms_bag.channel import ENCODING, Channel
from tms_bag.columns import Collector, Columns
from tms_bag.definitions import fields_of
from tms_bag.errors import RecordingError
from tms_bag.frames import DAMAGE, MAGIC
from tms_bag.index import FileIndex, Span, block_at, index_file, scan
from tms_bag.layout import Fields
from tms_bag.record import Record


MOST_OVERLAPPING = 1000  # parts whose times overlap; each of them is held until its last message is due

_Step = tuple[int, int, int, int, Record]


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
        first, last = _interval(start_ns, stop_ns)
        if topics is not None:
            self._check_topics(topics)
        active: list[tuple[int, int, int, int, Record, Iterator[_Step]]] = []
        for span_start, file_number, span, numbers in self._spans(topics, first, last):
            while active and active[0][0] < span_start:
                yield _next_of(active)
            if len(active) >= MOST_OVERLAPPING:
                raise RecordingError(
                    f"{self.path}: expected parts in much the order of time, found {len(active)} that overlap;"
                    f" `tms bag repair {self.path} -o NEW` can't help: record with one clock"
                )
            steps = self._steps(file_number, span, numbers, first, last)
            step = next(steps, None)
            if step is not None:
                heapq.heappush(active, (*step, steps))
        while active:
            yield _next_of(active)

    def columns(
        self,
        topics: Mapping[str, Collection[str] | None],
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> dict[str, Columns]:
        """Messages of these topics as arrays, from `start_ns` up to but not including `stop_ns` (log time).

        To each topic belong the fields wanted, None: all numbers and texts; what a type doesn't have is left
        out. Parts of the file that hold nothing of all that aren't read. RecordingError if there is no such
        topic, if a message isn't of its topic's type, or if messages aren't alike enough to be columns.
        """
        self._check_topics(topics)
        first, last = _interval(start_ns, stop_ns)
        collectors = {}
        for name, fields in topics.items():
            collectors[name] = Collector(name, self._type_of(name), fields, self._expected(name))
        spans = self._spans(topics, first, last)
        for file_number, numbers, block in in_advance(
            (partial(self._part, file_number, span, numbers) for _, file_number, span, numbers in spans)
        ):
            for number in numbers:
                channel = self._indexes[file_number].channels[number]
                rows = np.flatnonzero((block.channel == number) & within(block.log_time, first, last))
                if rows.size:
                    collectors[channel.name].add(block, rows, self._fields(channel))
        return {name: collector.columns() for name, collector in collectors.items()}

    def _part(
        self, file_number: int, span: Span, numbers: Sequence[int]
    ) -> tuple[int, Sequence[int], Block]:
        return file_number, numbers, self._block(file_number, span)

    def _fields(self, channel: Channel) -> Fields:
        if channel.encoding != ENCODING:
            raise RecordingError(
                f"{self.path}: expected messages in ROS 2's encoding {ENCODING}, found {channel.encoding!r} on"
                f" {channel.name}; choose topics without it"
            )
        return fields_of(channel)

    def _type_of(self, name: str) -> str:
        types = sorted({topic.type for topic in self.topics if topic.name == name and topic.count})
        if len(types) > 1:
            raise RecordingError(
                f"{self.path}: expected messages of one type on {name}, found {', '.join(types)}"
            )
        return types[0] if types else next(topic.type for topic in self.topics if topic.name == name)

    def _expected(self, name: str) -> int:
        """Messages to make room for at once: not more than a file of this size is likely to hold."""
        size = sum(os.fstat(file.fileno()).st_size for file in self._files)
        return min(sum(topic.count for topic in self.topics if topic.name == name), size // 16)

    def _spans(
        self, topics: Collection[str] | None, first: int, last: int
    ) -> list[tuple[int, int, Span, list[int]]]:
        """Parts that may hold messages of these topics in this interval, in the order of their first times.

        With each: the number of its file, and the channels wanted.
        """
        found = []
        for file_number, index in enumerate(self._indexes):
            wanted = [n for n, channel in index.channels.items() if topics is None or channel.name in topics]
            for span in index.spans:
                numbers = [n for n in wanted if span.channels is None or n in span.channels]
                if numbers and span.start_ns < last and span.end_ns >= first:
                    found.append((span.start_ns, file_number, span, numbers))
        return sorted(found, key=lambda entry: (entry[0], entry[1], entry[2].frame.start))

    def _block(self, file_number: int, span: Span) -> Block:
        try:
            return block_at(self._files[file_number], span)
        except DAMAGE as error:
            raise RecordingError(
                f"{self.path}: the part that starts at byte {span.frame.start} is damaged ({error});"
                f" `tms bag repair {self.path} -o NEW` saves the rest"
            ) from error

    def _steps(
        self, file_number: int, span: Span, numbers: Sequence[int], first: int, last: int
    ) -> Iterator[_Step]:
        """Messages of a part in the order of log time, and what they are sorted by."""
        block, channels = self._block(file_number, span), self._indexes[file_number].channels
        rows = block.rows_in_time_order(numbers, first, last)
        content, place = block.content, span.frame.start
        for order, (start, size, number, time, sent) in enumerate(
            zip(
                *(array[rows].tolist() for array in (block.start, block.size, block.channel)),
                *(array[rows].tolist() for array in (block.log_time, block.publish_time)),
                strict=True,
            )
        ):
            channel = channels[number]
            record = Record(channel.name, channel.type, time, content[start : start + size], sent)
            yield time, file_number, place, order, record

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


def _interval(start_ns: int | None, stop_ns: int | None) -> tuple[int, int]:
    return 0 if start_ns is None else start_ns, 2**64 if stop_ns is None else stop_ns


def _next_of(active: list[tuple[int, int, int, int, Record, Iterator[_Step]]]) -> Record:
    """The earliest record; the next one of its part takes its place."""
    *_, record, steps = active[0]
    following = next(steps, None)
    if following is None:
        heapq.heappop(active)
    else:
        heapq.heapreplace(active, (*following, steps))
    return record


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
