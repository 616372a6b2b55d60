"""Messages that stand together in a file: their bytes once, and arrays that say where each of them is."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from tms_bag.frames import HEADER_SIZE, Frame

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


def block_of(content: bytes) -> tuple[Block, list[Frame]]:
    """The messages among the records of a chunk, and all other records.

    ValueError if the records don't fill the content, or if a message is too short to be one.
    """
    places, others = _split(content)
    if not places.size:
        empty = np.empty(0, np.uint64)
        whole = np.empty(0, np.int64)
        return Block(content, whole, whole, empty.astype(np.uint16), empty, empty), others
    head = at_places(content, places, _HEAD)
    size = head["length"].astype(np.int64) - MESSAGE_HEAD
    if (size < 0).any():
        raise ValueError(f"message record of {int(head['length'].min())} bytes")
    return (
        Block(
            content,
            places + _HEAD_SIZE,
            size,
            head["channel"].copy(),
            head["log_time"].copy(),
            head["publish_time"].copy(),
        ),
        others,
    )


def at_places(content: bytes, places: NDArray[np.int64], kind: np.dtype[np.void]) -> NDArray[np.void]:
    """Structures that stand at these places of `content`: a view if they are equally far apart, else a copy.

    ValueError if one doesn't lie within the content.
    """
    if not places.size:
        return np.empty(0, kind)
    low, high = int(places.min()), int(places.max())
    if low < 0 or high + kind.itemsize > len(content):
        raise ValueError(f"{kind.itemsize} bytes at {high} of {len(content)}")
    step = int(places[1] - places[0]) if places.size > 1 else kind.itemsize
    if places.size < 3 or bool((np.diff(places) == step).all()):
        return np.ndarray(places.shape, kind, content, low if step > 0 else int(places[0]), (step,))
    windows: NDArray[np.void] = np.ndarray(
        (len(content) - kind.itemsize + 1,), np.dtype((np.void, kind.itemsize)), content, 0, (1,)
    )
    return windows[places].view(kind)


def _split(content: bytes) -> tuple[NDArray[np.int64], list[Frame]]:
    """Where the message records start, and all other records.

    Runs of equally long messages are found all at once, everything else record by record.
    """
    runs: list[NDArray[np.int64]] = []
    others: list[Frame] = []
    position, size, walk = 0, len(content), 0
    while position < size:
        if walk == 0:
            run = _run(content, position)
            if run.size:
                runs.append(run)
                position = int(run[-1]) + HEADER_SIZE + _RECORD.unpack_from(content, int(run[-1]))[1]
            walk = _LONGEST_WALK if run.size < 64 else 1
            continue
        places: list[int] = []
        for opcode, start, stop in _records(content, position, walk):
            if opcode == Opcode.MESSAGE:
                places.append(start - HEADER_SIZE)
            else:
                others.append(Frame(opcode, start, stop))
            position = stop
        runs.append(np.array(places, np.int64))
        walk = 0
    return (np.concatenate(runs) if runs else np.empty(0, np.int64)), others


def _run(content: bytes, position: int) -> NDArray[np.int64]:
    """Starts of the message records from `position` on that are as long as the first of them."""
    if len(content) - position < HEADER_SIZE or content[position] != Opcode.MESSAGE:
        return np.empty(0, np.int64)
    first = content[position : position + HEADER_SIZE]
    step = HEADER_SIZE + _RECORD.unpack(first)[1]
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
    return position + step * np.arange(found, dtype=np.int64)


def _records(content: bytes, position: int, count: int) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and stop of the content of the next `count` records. ValueError if one is cut off."""
    size, unpack = len(content), _RECORD.unpack_from
    for _ in range(count):
        if position >= size:
            return
        if size - position < HEADER_SIZE:
            raise ValueError(f"{size - position} bytes behind the last record")
        opcode, length = unpack(content, position)
        start = position + HEADER_SIZE
        position = start + length
        if opcode == 0 or position > size:  # 0 is not an opcode
            raise ValueError(f"record of {length} bytes at {start} of {size}")
        yield opcode, start, position
