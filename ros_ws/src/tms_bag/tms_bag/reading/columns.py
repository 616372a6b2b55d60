"""All messages of a topic as arrays, one for each number in a message.

No Python object is made for a message. Messages whose texts and sequences are equally long have the same
layout, so that a numpy structure laid over the records of a decompressed chunk reads them all at once; each
message's encapsulation and lengths are compared with those of the layout before.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tms_bag.errors import RecordingError
from tms_bag.growing import Growing, Rows
from tms_bag.reading.block import Block, Places, places_in
from tms_bag.reading.layout import Fields, Layout, LayoutError, layout_of
from tms_bag.samples import IntArray

Column = NDArray[Any]

MOST_SHAPES = 1000  # of one topic; a driver has one or two
FRAME_ID = "header.frame_id"
_FILLING = 3  # [bytes] that a message may be longer than it needs: RTPS fills up to a multiple of 4
_SEC, _NANOSEC = "header.stamp.sec", "header.stamp.nanosec"
_LAST_NS = np.uint64(2**63 - 1)


@dataclass(frozen=True, eq=False)
class Columns:
    """Messages of a topic in the order of log time, at equal times as they were written."""

    topic: str
    type: str
    log_time_ns: IntArray  # (n,) [ns] when they were recorded
    publish_time_ns: IntArray  # (n,) [ns] when they were sent
    stamp_ns: IntArray | None  # (n,) [ns] header.stamp; None: the type has no header
    values: dict[str, Column]  # (n,) or (n, k) by the field's name, for example angular_velocity.x
    texts: dict[str, tuple[str, ...]]  # different values of each text, in the order in which they come first

    @property
    def time_ns(self) -> IntArray:
        """Stamps of the messages (n,) [ns]; log times where the type has no header."""
        return self.log_time_ns if self.stamp_ns is None else self.stamp_ns

    @property
    def frame_id(self) -> str:
        """The first message's frame, empty without one."""
        return next(iter(self.texts.get(FRAME_ID, ())), "")

    def __len__(self) -> int:
        return int(self.log_time_ns.size)

    def __getitem__(self, name: str) -> Column:
        return self.values[name]

    def __contains__(self, name: str) -> bool:
        return name in self.values


class Collector:
    """Collects the messages of one topic, block by block. `wanted` are the numbers to keep, None: all.

    Room is made for `expected` messages at once, more when more come.
    """

    def __init__(self, topic: str, type_name: str, wanted: Collection[str] | None, expected: int) -> None:
        self.topic, self.type = topic, type_name
        self._wanted = None if wanted is None else {*wanted}
        self._expected = expected
        self._shapes: list[_Shape] = []
        self._begin()

    def _begin(self) -> None:
        self._log_time, self._publish_time, self._stamp = (
            Growing(np.dtype(np.int64), (), self._expected) for _ in range(3)
        )
        self._values: dict[str, Growing] = {}
        self._texts: dict[str, dict[bytes, None]] = {}
        self._count = 0

    def __len__(self) -> int:
        """Messages since the last `columns`."""
        return self._count

    def add(self, block: Block, rows: IntArray, fields: Fields) -> None:
        """Messages of a block. RecordingError if one isn't of the topic's type."""
        if not rows.size:
            return
        whole = Rows(self._count, rows.size)
        self._log_time.put(whole, np.minimum(block.log_time[rows], _LAST_NS))
        self._publish_time.put(whole, np.minimum(block.publish_time[rows], _LAST_NS))
        places, size = places_in(block.content, block.start[rows]), block.size[rows]
        members: IntArray | None = None  # rows that wait; None: all of them
        while size.size:
            row = int(rows[0 if members is None else members[0]])
            shape = self._shape(block.data(row), fields, int(block.log_time[row]))
            same = shape.fits(places, size)
            if same.all():
                self._keep(places, shape.layout, Rows(self._count, rows.size, members))
                break
            members = np.arange(rows.size) if members is None else members
            self._keep(places.chosen(same), shape.layout, Rows(self._count, rows.size, members[same]))
            places, size, members = places.chosen(~same), size[~same], members[~same]
        self._count += rows.size

    def columns(self) -> Columns:
        """What was added since the last time, in the order of log time."""
        log_time = self._log_time.whole(self._count)
        order = None if (log_time[1:] >= log_time[:-1]).all() else np.argsort(log_time, kind="stable")

        def finished(growing: Growing) -> Column:
            values = growing.whole(self._count)
            return values if order is None else values[order]

        found = Columns(
            topic=self.topic,
            type=self.type,
            log_time_ns=log_time if order is None else log_time[order],
            publish_time_ns=finished(self._publish_time),
            stamp_ns=finished(self._stamp) if self._stamp.used else None,
            values={name: finished(self._values.pop(name)) for name in list(self._values)},
            texts={
                name: tuple(text.decode("utf-8", "replace") for text in texts)
                for name, texts in self._texts.items()
            },
        )
        self._begin()
        return found

    def _shape(self, data: bytes, fields: Fields, log_time: int) -> _Shape:
        """One that the message fits. RecordingError if it isn't of the type."""
        place, size = places_in(data, np.zeros(1, np.int64)), np.array([len(data)])
        for known in self._shapes:
            if known.fields is fields and known.fits(place, size)[0]:
                return known
        try:
            shape = _shape_of(data, fields, self.type)
        except LayoutError as error:
            raise RecordingError(
                f"{self.topic} at {log_time} ns: expected a {self.type} message, found {len(data)} bytes that"
                f" aren't one ({error}): the recording is damaged or was made with another version of this"
                " type"
            ) from error
        if len(self._shapes) >= MOST_SHAPES:
            raise RecordingError(
                f"{self.topic}: expected messages of much the same shape, found more than {MOST_SHAPES}"
                " different ones: they can't be read as columns"
            )
        self._shapes.insert(0, shape)
        return shape

    def _keep(self, places: Places, layout: Layout, rows: Rows) -> None:
        table = places.at(0, layout.table)
        if _SEC in layout.names and _NANOSEC in layout.names:
            self._stamp.put(rows, table[_SEC].astype(np.int64) * 10**9 + table[_NANOSEC])
        for name in layout.names:
            if name in (_SEC, _NANOSEC) or not (self._wanted is None or name in self._wanted):
                continue
            values = table[name]
            if values.dtype == np.bool_:  # whatever is not 0, as other readers take it
                values = values.view(np.uint8) != 0
            if name not in self._values:
                kind = values.dtype.newbyteorder("=")
                self._values[name] = Growing(kind, values.shape[1:], self._expected)
            if self._values[name].shape != values.shape[1:]:
                raise RecordingError(
                    f"{self.topic}: expected {name} of the same length in all messages, found"
                    f" {self._values[name].shape} and {values.shape[1:]}: it can't be read as a column"
                )
            self._values[name].put(rows, values)
        for name, (first, last) in layout.texts.items():
            if self._wanted is None or name in self._wanted or name == FRAME_ID:
                self._keep_text(name, places, first, last - first)

    def _keep_text(self, name: str, places: Places, start: int, size: int) -> None:
        known = self._texts.setdefault(name, {})
        if size == 0:
            known[b""] = None
        elif len(known) < MOST_SHAPES:
            letters = places.at(start, np.dtype((np.bytes_, size)))
            if (letters == letters[0]).all():
                letters = letters[:1]
            for text in dict.fromkeys(letters.tolist()):
                known[text] = None


@dataclass(frozen=True, eq=False)
class _Shape:
    """A layout, and what tells that a message has it: its encapsulation and the lengths in it."""

    fields: Fields  # the definitions it was made with
    layout: Layout
    signs: tuple[tuple[int, np.dtype[Any], int], ...]  # place [bytes], format, value

    def fits(self, places: Places, size: IntArray) -> NDArray[np.bool_]:
        """Which of the messages at these places have this shape."""
        fitting = (size >= self.layout.size) & (size <= self.layout.size + _FILLING)
        for place, kind, value in self.signs:
            if fitting.all():
                fitting = places.at(place, kind) == value
            else:
                fitting[fitting] = places.chosen(fitting).at(place, kind) == value
        return fitting


def _shape_of(data: bytes, fields: Fields, type_name: str) -> _Shape:
    layout = layout_of(fields, type_name, data)
    if not layout.size <= len(data) <= layout.size + _FILLING:
        raise LayoutError(f"expected {layout.size} bytes")
    short, long = np.dtype("<u2"), np.dtype("<u4")
    places: list[tuple[int, np.dtype[Any]]] = [(0, short), *((place, long) for place in layout.lengths)]
    signs = tuple(
        (place, kind, int.from_bytes(data[place : place + kind.itemsize], "little")) for place, kind in places
    )
    return _Shape(fields, layout, signs)
