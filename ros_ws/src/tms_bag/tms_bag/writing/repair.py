"""A clean bag out of an unfinished or damaged one."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from tms_bag.errors import RecordingError
from tms_bag.reading.reader import BagReader
from tms_bag.record import Record
from tms_bag.writing.writer import BagWriter

Progress = Callable[[Iterable[Record]], Iterable[Record]]


@dataclass(frozen=True)
class Repair:
    """What a repair did."""

    output: Path | None  # the clean bag; None: there was nothing to repair
    message_count: int  # messages in it
    damaged_chunks: int  # parts that had to be left out
    unread_bytes: int  # at the end of the files, no complete part any more
    saved: int  # messages that were in these bytes nevertheless
    original: Path | None  # where the bag as it was is kept, if the clean one took its place


def repair(
    path: str | os.PathLike[str], output: str | os.PathLike[str] | None = None, progress: Progress = iter
) -> Repair:
    """Write what can be read of a bag as a finished bag of one file, with its metadata.yaml.

    Without `output` the clean bag takes the place of the old one, which is kept beside it as NAME.unrepaired.
    RecordingError, and nothing is changed, if there is no message to recover.
    """
    source = Path(path)
    with BagReader(source, salvage=True) as bag:
        damaged = sum(index.damaged_chunks for index in bag.indexes)
        unread = sum(index.unread_bytes for index in bag.indexes)
        saved = sum(index.saved for index in bag.indexes)
        if bag.complete and output is None:
            return Repair(None, bag.message_count, 0, 0, 0, None)
        if not bag.message_count:
            raise RecordingError(
                f"{source}: expected messages to recover, found none"
                + (f": {unread} bytes can't be read" if unread or damaged else ", and nothing is missing")
            )
        original = None if output is not None else _place_for_original(source)
        target = source if output is None else Path(output)
        with BagWriter(target, bag.custom_data, keep_old_as=original) as writer:
            _copy(bag, writer, progress)
        return Repair(target, sum(writer.counts.values()), damaged, unread, saved, original)


def _copy(bag: BagReader, writer: BagWriter, progress: Progress) -> None:
    """All messages, with the topics' definitions as they stand in the bag."""
    for channel in bag.channels:
        if channel.name not in writer.counts:
            writer.add_channel(channel)
    for record in progress(bag.records()):
        writer.write(record)


def _place_for_original(source: Path) -> Path:
    if not source.is_dir():
        raise RecordingError(f"{source}: a single file can't become a bag in place; say -o NEW_BAG")
    path = Path.cwd() / source
    original = path.with_name(f"{path.name}.unrepaired")
    if os.path.lexists(original):
        raise RecordingError(
            f"{original}: exists already, from an earlier repair; move it away or say -o NEW_BAG"
        )
    return original
