"""Messages that stand together in a file: their bytes once, and arrays that say where each of them is."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from tms_bag.reading.frames import HEADER_SIZE, Frame

UintArray = NDArray[np.uint64]

_RECORD = struct.Struct("<BQ")
MESSAGE_HEAD = 22  # [bytes] channel, sequence and times before a message's data
_HEAD_SIZE = HEADER_SIZE + MESSAGE_HEAD
_HEAD = np.dtype(
    {
        "names": ["length", "channel", "log_time", "publish_time"],
        "formats": ["<u8", "<u2", "<u8", "<u8"],
        "offsets": [1, 9, 15, 23],
        "itemsize": _HEAD_SIZE,
    }
)
_LONGEST_WALK = 1024  # records looked at one by one before another run of equal ones is tried


@dataclass(frozen=True, eq=False)
class Block:
    """Messages in the order in which they were written."""

    content: bytes
    start: NDArray[np.int64]  # (n,) place of each message's data in `content`
    size: NDArray[np.int64]  # (n,) [bytes] of each message's data
    channel: NDArray[np.uint16]  # (n,) number of its channel in the file
    log_time: UintArray  # (n,) [ns]
    publish_time: UintArray  # (n,) [ns]

    def data(self, row: int) -> bytes:
        """A message's data."""
        start = int(self.start[row])
        return self.content[start : start + int(self.size[row])]

    def rows_in_time_order(self, channels: Sequence[int], first: int, last: int) -> NDArray[np.int64]:
        """Messages of these channels with first <= log time < last; at equal times as they were written."""
        rows = np.flatnonzero(np.isin(self.channel, channels) & within(self.log_time, first, last))
        times = self.log_time[rows]
        if (times[1:] >= times[:-1]).all():
            return rows
        return rows[np.argsort(times, kind="stable")]


def within(times: UintArray, first: int, last: int) -> NDArray[np.bool_]:
    """Which times are in the half-open interval; its ends may be any integers."""
    if last <= 0 or first >= 2**64:
        return np.zeros(times.size, bool)
    inside = times >= np.uint64(max(first, 0))
    return inside & (times < np.uint64(last)) if last < 2**64 else inside


def block_of(content: bytes, start: int = 0) -> tuple[Block, list[Frame]]:
    """The messages among the records of a chunk, which start at a place of `content`, and all other records.

    ValueError if the records don't fill the content, or if a message is too short to be one.
    """
    block, others, stop = begun_block_of(content, start)
    short = next((frame for frame in others if frame.opcode == Opcode.MESSAGE), None)
    if stop != len(content) or short:
        wrong = f"message record of {short.stop - short.start} bytes" if short else f"no record at {stop}"
        raise ValueError(f"{wrong} in {len(content) - start} bytes")
    return block, others


def begun_block_of(content: bytes, start: int = 0) -> tuple[Block, list[Frame], int]:
    """Messages and all other records as far as they are complete, and where that ends.

    Messages that are too short to be one stand among the others.
    """
    places, others, stop = _split(content, start)
    if not places.size:
        none = np.empty(0, np.uint64)
        nowhere = np.empty(0, np.int64)
        return Block(content, nowhere, nowhere, none.astype(np.uint16), none, none), others, stop
    head = places_in(content, places).at(0, _HEAD)
    block = Block(
        content=content,
        start=places + _HEAD_SIZE,
        size=head["length"].astype(np.int64) - MESSAGE_HEAD,
        channel=head["channel"].copy(),
        log_time=head["log_time"].copy(),
        publish_time=head["publish_time"].copy(),
    )
    return block, others, stop


@dataclass(frozen=True, eq=False)
class Places:
    """Places in `content`; whether they are equally far apart is found out once."""

    content: bytes
    start: NDArray[np.int64]  # (n,)
    step: int  # [bytes] from each to the next; 0: it isn't the same everywhere

    def at(self, offset: int, kind: np.dtype[Any]) -> NDArray[Any]:
        """Structures `offset` behind the places: a view if they are equally far apart, else a copy.

        ValueError if one doesn't lie within the content.
        """
        if not self.start.size:
            return np.empty(0, kind)
        ends = (self.start[0], self.start[-1]) if self.step else (self.start.min(), self.start.max())
        low, high = int(min(ends)) + offset, int(max(ends)) + offset
        if low < 0 or high + kind.itemsize > len(self.content):
            raise ValueError(f"{kind.itemsize} bytes at {high} of {len(self.content)}")
        if self.step:
            first = int(self.start[0]) + offset
            return np.ndarray(self.start.shape, kind, self.content, first, (self.step,))
        windows: NDArray[np.void] = np.ndarray(
            (len(self.content) - kind.itemsize + 1,),
            np.dtype((np.void, kind.itemsize)),
            self.content,
            0,
            (1,),
        )
        return windows[self.start + offset].view(kind)

    def chosen(self, rows: NDArray[Any]) -> Places:
        """Some of them, by their numbers or a mask."""
        return places_in(self.content, self.start[rows])


def places_in(content: bytes, start: NDArray[np.int64]) -> Places:
    """Places (n,) in `content`."""
    if start.size < 2:
        return Places(content, start, 1)
    step = int(start[1] - start[0])
    return Places(content, start, step if start.size < 3 or bool((np.diff(start) == step).all()) else 0)


def _split(content: bytes, position: int) -> tuple[NDArray[np.int64], list[Frame], int]:
    """Where the message records from a place on start, all others, and where the complete records end.

    Runs of equally long messages are found all at once, everything else record by record.
    """
    runs: list[NDArray[np.int64]] = [np.empty(0, np.int64)]
    others: list[Frame] = []
    walk = 0
    while True:
        if walk == 0:
            run, position = _run(content, position)
            runs.append(run)
            walk = _LONGEST_WALK if run.size < 64 else 1
            continue
        places: list[int] = []
        before = position
        for opcode, start, stop in _records(content, position, walk):
            if opcode == Opcode.MESSAGE and stop - start >= MESSAGE_HEAD:
                places.append(start - HEADER_SIZE)
            else:
                others.append(Frame(opcode, start, stop))
            position = stop
        runs.append(np.array(places, np.int64))
        if position == before:
            return np.concatenate(runs), others, position
        walk = 0


def _run(content: bytes, position: int) -> tuple[NDArray[np.int64], int]:
    """Starts of the message records from `position` on that are as long as the first, and where they end."""
    none = np.empty(0, np.int64), position
    if len(content) - position < _HEAD_SIZE or content[position] != Opcode.MESSAGE:
        return none
    first = content[position : position + HEADER_SIZE]
    step = HEADER_SIZE + _RECORD.unpack(first)[1]
    if step < _HEAD_SIZE:
        return none
    count, found, tried = (len(content) - position) // step, 0, 64
    while found < count:  # twice as many each time, so that a short run doesn't cost a look at everything
        tried = min(2 * tried, count - found)
        start = position + found * step
        heads: NDArray[np.uint8] = np.ndarray((tried, HEADER_SIZE), np.uint8, content, start, (step, 1))
        other = (heads != np.frombuffer(first, np.uint8)).any(axis=1)
        if other.any():
            found += int(np.argmax(other))
            break
        found += tried
    if not found:
        return none
    return np.asarray(position + step * np.arange(found, dtype=np.int64)), position + step * found


def _records(content: bytes, position: int, count: int) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and stop of the content of the next `count` records, as far as they are complete."""
    size, unpack = len(content), _RECORD.unpack_from
    for _ in range(count):
        if size - position < HEADER_SIZE:
            return
        opcode, length = unpack(content, position)
        start = position + HEADER_SIZE
        position = start + length
        if opcode == 0 or position > size:  # 0 is not an opcode
            return
        yield opcode, start, position
