"""Where the numbers and texts of a CDR message stand.

Plain CDR (XCDR version 1, as ROS 2 writes it): numbers are aligned to their size, counted from the end of the
4 bytes of encapsulation; texts and sequences say their length before. Messages of one type whose texts and
sequences are equally long have the same layout: with one of them at hand it's known for all.
Format: OMG DDS-XTypes 1.3, 7.4.3.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

Fields = Mapping[str, Any]  # type name -> constants and fields, as rosbags describes them

ENCAPSULATION = {b"\x00\x01": "<", b"\x00\x00": ">"}  # plain CDR, little and big endian
ENCAPSULATION_SIZE = 4  # [bytes]
MOST_COLUMNS = 4096  # of a message; a point cloud's or an image's bytes are one
DEEPEST = 32  # messages in messages

_FORMATS = {"bool": "?", "byte": "u1", "char": "u1", "octet": "u1"}  # what numpy calls otherwise


class LayoutError(ValueError):
    """Bytes that aren't a message of the type, or a type that can't be laid out."""


@dataclass(frozen=True)
class Layout:
    """Places of the contents of a message, from the first byte of its encapsulation on."""

    names: tuple[str, ...]  # of the numbers, for example angular_velocity.x
    formats: tuple[str, ...]  # numpy's, an array's or sequence's with its length
    offsets: tuple[int, ...]  # [bytes]
    texts: dict[str, tuple[int, int]]  # where a text starts and stops, its final zero not counted
    lengths: tuple[int, ...]  # [bytes] where the lengths of texts and sequences stand, 4 bytes each
    size: int  # [bytes] of the whole message

    @cached_property
    def table(self) -> np.dtype[np.void]:
        """The numbers as columns of a table whose rows are the messages."""
        return self.columns()

    def columns(self, before: int = 0, itemsize: int = 0) -> np.dtype[np.void]:
        """The numbers as columns of a table, whose rows have `before` bytes before the message."""
        return np.dtype(
            {
                "names": list(self.names),
                "formats": list(self.formats),
                "offsets": [before + offset for offset in self.offsets],
                "itemsize": max(before + self.size, itemsize),
            }
        )


def layout_of(fields: Fields, type_name: str, data: bytes) -> Layout:
    """Layout of a message of this type. LayoutError if the bytes aren't one."""
    order = ENCAPSULATION.get(data[:2], "")
    if not order:
        raise LayoutError(f"encapsulation {data[:2].hex() or 'missing'}")
    byte_order = "little" if order == "<" else "big"

    def length_at(place: int) -> int:
        if place + 4 > len(data):
            raise LayoutError(f"{len(data)} bytes, too few")
        return int.from_bytes(data[place : place + 4], byte_order)  # type: ignore[arg-type]

    layout = arranged(fields, type_name, order, length_at, len(data))
    for start, stop in layout.texts.values():
        if stop > start and data[stop : stop + 1] != b"\x00":
            raise LayoutError(f"a text at byte {start} without its end")
    return layout


def arranged(
    fields: Fields, type_name: str, order: str, length_at: Callable[[int], int], limit: int
) -> Layout:
    """Layout of a message of at most `limit` bytes; `length_at` tells the length that stands at a place."""
    arranging = _Arranging(fields, order, length_at, limit)
    arranging.message(type_name, "", 0)
    return Layout(
        tuple(arranging.names),
        tuple(arranging.formats),
        tuple(arranging.offsets),
        arranging.texts,
        tuple(arranging.lengths),
        arranging.position,
    )


@dataclass
class _Arranging:
    """Goes through a type's fields in their order."""

    fields: Fields
    order: str
    length_at: Callable[[int], int]
    limit: int
    names: list[str] = field(default_factory=list)
    formats: list[str] = field(default_factory=list)
    offsets: list[int] = field(default_factory=list)
    texts: dict[str, tuple[int, int]] = field(default_factory=dict)
    lengths: list[int] = field(default_factory=list)
    position: int = ENCAPSULATION_SIZE

    def message(self, type_name: str, prefix: str, depth: int) -> None:
        """All fields of a message."""
        if depth > DEEPEST:
            raise LayoutError(f"more than {DEEPEST} messages in each other")
        fields = self.fields[type_name][1]
        if not fields:
            self._advance(1)  # rosidl gives a message of nothing a byte: structure_needs_at_least_one_member
        for name, (kind, content) in fields:
            if kind == Nodetype.ARRAY:
                self._elements(content[0], content[1], prefix + name, depth)
            elif kind == Nodetype.SEQUENCE:
                self._elements(content[0], self._length(), prefix + name, depth)
            else:
                self._one(kind, content, prefix + name, depth)

    def _one(self, kind: Any, content: Any, name: str, depth: int) -> None:
        if kind == Nodetype.NAME:
            self.message(content, name + ".", depth + 1)
        elif content[0] == "string":
            length = self._length()
            self.texts[name] = self.position, self.position + max(length - 1, 0)
            self._advance(length)
        else:
            self._numbers(content[0], None, name)

    def _elements(self, element: tuple[Any, Any], count: int, name: str, depth: int) -> None:
        kind, content = element
        if kind == Nodetype.BASE and content[0] != "string":
            self._numbers(content[0], count, name)
            return
        if count > MOST_COLUMNS:
            raise LayoutError(f"{name} with {count} elements")
        for number in range(count):
            self._one(kind, content, f"{name}[{number}]", depth)

    def _numbers(self, kind: str, count: int | None, name: str) -> None:
        try:
            code = _FORMATS.get(kind) or np.dtype(kind).str[1:]
        except TypeError as error:
            raise LayoutError(f"{name} of type {kind}") from error
        size = int(np.dtype(code).itemsize)
        if count != 0:
            self._advance((ENCAPSULATION_SIZE - self.position) % size)
        start = self.position
        self._advance(size * (1 if count is None else count))
        if len(self.names) >= MOST_COLUMNS:
            raise LayoutError(f"more than {MOST_COLUMNS} numbers")
        self.names.append(name)
        self.offsets.append(start)
        self.formats.append(self.order + code if count is None else f"({count},){self.order}{code}")

    def _length(self) -> int:
        """Length of a text or a sequence, which stands before it."""
        self._advance(-self.position % 4)
        place = self.position
        self._advance(4)
        self.lengths.append(place)
        if len(self.lengths) > MOST_COLUMNS:
            raise LayoutError(f"more than {MOST_COLUMNS} texts and sequences")
        return self.length_at(place)

    def _advance(self, size: int) -> None:
        self.position += size
        if self.position > self.limit:
            raise LayoutError(f"{self.limit} bytes, too few")
