"""One message of numbers alone, for a live stream: in a fraction of the time of a table or an object.

For the types that `tms_bag.reading.tables` is for. The places of the numbers are those of a table's columns,
made into a `struct` once for each type and frame.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any

from tms_bag.reading.layout import ENCAPSULATION
from tms_bag.reading.tables import LENGTH_PLACE, TEXT_PLACE, TEXT_STOP, MessageError, fixed_layout

_CODES = {
    "b1": "?", "i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q",
    "f4": "f", "f8": "d",
}  # fmt: skip
STAMP = ("stamp.sec", "stamp.nanosec")


def read_numbers(type_name: str, names: tuple[str, ...], data: bytes) -> tuple[Any, ...]:
    """The stamp [ns] and the numbers called `names`, in the message's order, of arrays one after the other.

    MessageError if the bytes aren't a message of this type.
    """
    length = int.from_bytes(data[LENGTH_PLACE:TEXT_PLACE], "little" if data[1:2] == b"\x01" else "big")
    text = data[TEXT_PLACE : min(TEXT_PLACE + length, TEXT_STOP)]
    form = _reading_form(type_name, names, data[:2], text)
    if form is None or not form.size <= len(data) <= form.size + 3:
        raise MessageError(type_name, 0, len(data))
    seconds, nanoseconds, *numbers = form.unpack_from(data)
    return (seconds * 1_000_000_000 + nanoseconds, *numbers)


def write_numbers(
    type_name: str, names: tuple[str, ...], frame_id: str, time_ns: int, numbers: Iterable[Any]
) -> bytes:
    """CDR bytes, as `tms_bag.messages.serialize` makes them, of a message's header and all other numbers.

    names: all of them, in the message's order; TypeError if they aren't. numbers: of arrays one after the
    other.
    """
    form, text = _writing_form(type_name, names, frame_id)
    return form.pack(b"\x00\x01", *divmod(time_ns, 1_000_000_000), text, *numbers)


@lru_cache(maxsize=256)
def _reading_form(
    type_name: str, names: tuple[str, ...], encapsulation: bytes, text: bytes
) -> struct.Struct | None:
    """How messages that begin so are read; None: they aren't messages."""
    order = ENCAPSULATION.get(encapsulation, "")
    if not (order and text[-1:] in (b"\x00", b"")):
        return None
    return _form(type_name, len(text), order, (*STAMP, *names), padded=False)


@lru_cache(maxsize=64)
def _writing_form(type_name: str, names: tuple[str, ...], frame_id: str) -> tuple[struct.Struct, bytes]:
    """How messages of a frame are written, and their text with its length before it."""
    text = frame_id.encode() + b"\x00"
    written = len(text).to_bytes(4, "little") + text
    found = fixed_layout(type_name, len(text), "<", padded=True).names or ()
    if found != (*STAMP, *names):
        raise TypeError(f"{type_name}: expected the numbers {found}, found {names}")
    form = _form(type_name, len(text), "<", found, padded=True, around=("2s", f"{len(written)}s"))
    return form, written


def _form(
    type_name: str,
    text_length: int,
    order: str,
    names: tuple[str, ...],
    padded: bool,
    around: tuple[str, str] = ("", ""),
) -> struct.Struct:
    """The numbers at their places and nothing between them, but what stands before and behind the stamp."""
    layout = fixed_layout(type_name, text_length, order, padded)
    places: Mapping[str, Any] = layout.fields or {}
    form = order + around[0]
    for name in names:
        kind, offset = places[name][:2]
        count = kind.itemsize // kind.base.itemsize
        form += f"{offset - struct.calcsize(form)}x{count}{_CODES[kind.base.str[1:]]}"
        if name == STAMP[-1]:
            form += around[1]
    return struct.Struct(f"{form}{layout.itemsize - struct.calcsize(form)}x")
