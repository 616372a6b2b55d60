"""Bags read: a folder with rosbag2's files, or one of its files, finished or not."""

from __future__ import annotations

import heapq
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tms_bag.channel import Channel, check_encoding
from tms_bag.errors import RecordingError
from tms_bag.reading.advance import in_advance
from tms_bag.reading.bag_files import files_of
from tms_bag.reading.block import Block, within
from tms_bag.reading.columns import Collector, Columns
from tms_bag.reading.definitions import fields_of
from tms_bag.reading.frames import DAMAGE
from tms_bag.reading.index import FileIndex, Span
from tms_bag.reading.layout import Fields
from tms_bag.reading.mcap_source import McapSource
from tms_bag.reading.packed_file import kind_of
from tms_bag.reading.packed_messages import with_messages_unpacked
from tms_bag.record import Record

if TYPE_CHECKING:
    from tms_bag.reading.db3_source import Db3Source

MOST_HELD = 2**28  # [bytes] of parts whose times overlap; each is held until its last message is due
PART = 4096  # messages that are decoded together in `parts`

_Step = tuple[int, int, int, int, Record]
_Stream = tuple[int, int, int, int, Record, Iterator[_Step], int]


class Topic(NamedTuple):
    """A topic of a bag."""

    name: str
    type: str
    count: int  # type: ignore[assignment]  # messages; hides tuple.count, which nobody needs here


def open_bag(path: str | os.PathLike[str], salvage: bool = False) -> BagReader:
    """Reader of a bag, a context manager.

    path: folder of a bag, or an .mcap or .db3 file. salvage: everything that can be read, whatever summaries
    say. Raises RecordingError if it holds nothing readable.

    >>> with open_bag("bags/tms_strike") as bag:
    ...     print(bag.message_count > 0, bag.topics[0].name)
    True /bicycle/events
    """
    return BagReader(path, salvage)


class BagReader:
    """Reads a bag; use it as a context manager. RecordingError if `path` holds nothing readable.

    With `salvage` everything that can be read is, whatever the summaries and the metadata.yaml say: damaged
    parts are left out, `indexes` tell how much that was.
    """

    def __init__(self, path: str | os.PathLike[str], salvage: bool = False) -> None:
        self.path = Path(path)
        self.salvage = salvage
        paths, stored = files_of(self.path, salvage)
        self._files: list[McapSource | Db3Source] = []
        try:
            for name in paths:
                self._files.append(_opened(name, salvage, alone=len(paths) == 1))
        except BaseException:
            self.close()
            raise
        self._indexes = [file.index for file in self._files]
        in_files: dict[str, str] = {}
        for index in self._indexes:
            in_files.update(index.custom_data)
        self.custom_data = stored.custom_data if stored and stored.custom_data else in_files
        listed = stored is not None or self.path.is_file()
        self.complete = listed and all(index.complete for index in self._indexes)
        self.warnings = tuple(
            text for file in self._files for text in (_unfinished(file), _undefined(file)) if text
        )

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
        active: list[_Stream] = []
        held = 0
        for span_start, file_number, span, numbers in self._spans(topics, first, last):
            while active and active[0][0] < span_start:
                record, freed = _next_of(active)
                held -= freed
                yield record
            block = self._block(file_number, span)
            steps = self._steps(file_number, span, block, numbers, first, last)
            step = next(steps, None)
            if step is not None:
                held += len(block.content)
                heapq.heappush(active, (*step, steps, len(block.content)))
            if held > MOST_HELD:
                raise RecordingError(
                    f"{self.path}: expected parts in much the order of time, found {len(active)} of them"
                    f" overlapping ({held} bytes): read a shorter stretch, with start and stop"
                )
        while active:
            yield _next_of(active)[0]

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
        collectors = self._collectors(topics, in_parts=False)
        for _ in self._collecting(collectors, start_ns, stop_ns):
            pass
        return {name: collector.columns() for name, collector in collectors.items()}

    def parts(self, topics: Mapping[str, Collection[str] | None]) -> Iterator[Columns]:
        """As `columns`, some messages at a time, for who doesn't need the arrays of all of them at once.

        Each part is of one topic and sorted by log time, the parts of a topic only roughly.
        """
        collectors = self._collectors(topics, in_parts=True)
        for collector in self._collecting(collectors, None, None):
            if len(collector) >= PART:
                yield collector.columns()
        yield from (collector.columns() for collector in collectors.values() if len(collector))

    def _collectors(
        self, topics: Mapping[str, Collection[str] | None], in_parts: bool
    ) -> dict[str, Collector]:
        self._check_topics(topics)
        found = {}
        for name, fields in topics.items():
            expected = min(self.expected(name), PART if in_parts else 2**63)
            found[name] = Collector(name, self._type_of(name), fields, expected)
        return found

    def _collecting(
        self, collectors: Mapping[str, Collector], start_ns: int | None, stop_ns: int | None
    ) -> Iterator[Collector]:
        """Feeds the collectors, block by block; yields each that got something."""
        first, last = _interval(start_ns, stop_ns)
        spans = self._spans(collectors, first, last)
        for file_number, numbers, block in in_advance(
            partial(self._part, file_number, span, numbers) for _, file_number, span, numbers in spans
        ):
            for number in numbers:
                channel = self._indexes[file_number].channels[number]
                rows = np.flatnonzero((block.channel == number) & within(block.log_time, first, last))
                if rows.size:
                    collectors[channel.name].add(block, rows, self._fields(channel))
                    yield collectors[channel.name]

    def _part(self, file_number: int, span: Span, numbers: Sequence[int]) -> tuple[int, Sequence[int], Block]:
        return file_number, numbers, self._block(file_number, span)

    def _fields(self, channel: Channel) -> Fields:
        try:
            check_encoding(channel)
        except RecordingError as error:
            raise RecordingError(f"{self.path}: {error}") from error
        return fields_of(channel)

    def _type_of(self, name: str) -> str:
        types = sorted({topic.type for topic in self.topics if topic.name == name and topic.count})
        if len(types) > 1:
            raise RecordingError(
                f"{self.path}: expected messages of one type on {name}, found {', '.join(types)}"
            )
        return types[0] if types else next(topic.type for topic in self.topics if topic.name == name)

    def expected(self, name: str) -> int:
        """Messages to make room for at once: not more than a file of this size is likely to hold."""
        size = sum(file.size for file in self._files)
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
            block = self._files[file_number].block(span)
            return with_messages_unpacked(block, self._indexes[file_number].channels)
        except DAMAGE as error:
            raise RecordingError(
                f"{self.path}: the part that starts at byte {span.frame.start} is damaged ({error});"
                f" `tms bag repair {self.path} -o NEW` saves the rest"
            ) from error

    def _steps(
        self, file_number: int, span: Span, block: Block, numbers: Sequence[int], first: int, last: int
    ) -> Iterator[_Step]:
        """Messages of a part in the order of log time, and what they are sorted by."""
        channels = self._indexes[file_number].channels
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


def _opened(path: Path, salvage: bool, alone: bool) -> McapSource | Db3Source:
    if kind_of(path) == ".db3":
        from tms_bag.reading.db3_source import Db3Source  # here, since it loads the reader of rosbags

        return Db3Source(path)
    return McapSource(path, salvage, may_be_empty=salvage and not alone)  # the others may hold something


def _unfinished(file: McapSource | Db3Source) -> str:
    """What is wrong with a file that wasn't closed properly, and how far it goes."""
    index = file.index
    if index.complete:
        return ""
    until = f"messages until {index.time_range[1]} ns are here" if index.time_range else "no message is here"
    damaged = f", {index.damaged_chunks} damaged parts are left out" if index.damaged_chunks else ""
    saved = f", {index.saved} messages saved from it" if index.saved else ", which can't be read"
    cut = (
        f", {index.unread_bytes} bytes at its end are an incomplete part{saved}" if index.unread_bytes else ""
    )
    return (
        f"{file.path}: this file is unfinished: its recorder was killed, or the copy is cut short; {until}"
        f"{cut}{damaged}; `tms bag repair` makes a clean bag of it"
    )


def _undefined(file: McapSource | Db3Source) -> str:
    """How many messages of a file nobody can attribute to a topic."""
    count = sum(n for number, n in file.index.counts.items() if number not in file.index.channels)
    return (
        f"{file.path}: {count} messages are of channels that the file doesn't define: left out"
        if count
        else ""
    )


def _interval(start_ns: int | None, stop_ns: int | None) -> tuple[int, int]:
    return 0 if start_ns is None else start_ns, 2**64 if stop_ns is None else stop_ns


def _next_of(active: list[_Stream]) -> tuple[Record, int]:
    """The earliest record, and how many bytes are free after it; the next one of its part takes its place."""
    *_, record, steps, size = active[0]
    following = next(steps, None)
    if following is None:
        heapq.heappop(active)
        return record, size
    heapq.heapreplace(active, (*following, steps, size))
    return record, 0
