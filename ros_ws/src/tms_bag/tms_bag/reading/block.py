"""Messages that stand together in a file: their bytes once, and arrays that say where each of them is."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

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


def block_of(content: bytes) -> tuple[Block, list[Frame]]:
    """The messages among the records of a chunk, and all other records.

    ValueError if the records don't fill the content, or if a message is too short to be one.
    """
    block, others, stop = begun_block_of(content)
    short = next((frame for frame in others if frame.opcode == Opcode.MESSAGE), None)
    if stop != len(content) or short:
        wrong = f"message record of {short.stop - short.start} bytes" if short else f"no record at {stop}"
        raise ValueError(f"{wrong} in {len(content)} bytes")
    return block, others


def begun_block_of(content: bytes) -> tuple[Block, list[Frame], int]:
    """Messages and all other records as far as they are complete, and where that ends.

    Messages that are too short to be one stand among the others.
    """
    places, others, stop = _split(content)
    if not places.size:
        none = np.empty(0, np.uint64)
        nowhere = np.empty(0, np.int64)
        return Block(content, nowhere, nowhere, none.astype(np.uint16), none, none), others, stop
    head = at_places(content, places, _HEAD)
    block = Block(
        content=content,
        start=places + _HEAD_SIZE,
        size=head["length"].astype(np.int64) - MESSAGE_HEAD,
        channel=head["channel"].copy(),
        log_time=head["log_time"].copy(),
        publish_time=head["publish_time"].copy(),
    )
    return block, others, stop


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


def _split(content: bytes) -> tuple[NDArray[np.int64], list[Frame], int]:
    """Where the message records start, all other records, and where the complete records end.

    Runs of equally long messages are found all at once, everything else record by record.
    """
    runs: list[NDArray[np.int64]] = [np.empty(0, np.int64)]
    others: list[Frame] = []
    position, walk = 0, 0
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
