"""Many messages of one type as one numpy table: a row per message, a column per number in it.

For types that start with a std_msgs/Header and hold nothing but numbers behind it. With the frame_id given,
all their messages are equally long, and each number stands at the same place in all of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tms_bag.errors import RecordingError
from tms_bag.messages import all_fields
from tms_bag.reading.layout import ENCAPSULATION, arranged
from tms_bag.samples import IntArray

Table = NDArray[np.void]  # structured; columns are called as in the message, for example angular_velocity.x

LENGTH_PLACE, TEXT_PLACE = 12, 16  # [bytes] where the length of the header's text and the text stand
TEXT_STOP = TEXT_PLACE + 2**15  # [bytes] no frame_id goes further; what a message says it has may


class MessageError(RecordingError):
    """Bytes that aren't a message of the expected type."""

    def __init__(self, type_name: str, row: int, length: int) -> None:
        super().__init__(
            f"expected a {type_name} message, found {length} bytes that aren't one:"
            " the recording is damaged or was made with another version of this type"
        )
        self.row = row  # which of the messages


def new_table(type_name: str, time_ns: IntArray, frame_id: str) -> Table:
    """Table of messages with these stamps (n,) [ns] and this frame, all other numbers 0."""
    text = frame_id.encode() + b"\x00"
    table: Table = np.zeros(time_ns.size, fixed_layout(type_name, len(text), "<", padded=True))
    raw = table.view(np.uint8).reshape(time_ns.size, table.itemsize)
    raw[:, 1] = 1  # little endian
    raw[:, LENGTH_PLACE:TEXT_PLACE] = np.frombuffer(len(text).to_bytes(4, "little"), np.uint8)
    raw[:, TEXT_PLACE : TEXT_PLACE + len(text)] = np.frombuffer(text, np.uint8)
    table["stamp.sec"], table["stamp.nanosec"] = np.divmod(time_ns, 10**9)
    return table


def rows(table: Table) -> Iterator[bytes]:
    """The messages of a table as CDR bytes, filled up to a multiple of 4."""
    content, size = table.tobytes(), table.itemsize
    return (content[start : start + size] for start in range(0, len(content), size))


def read_table(type_name: str, messages: Sequence[bytes]) -> tuple[Table, list[str]]:
    """Table of messages and the frame_id of each. MessageError if one isn't of this type.

    Messages may have different frames, byte orders, and up to 3 bytes more than they need.
    """
    groups: dict[bytes, list[int]] = {}
    for row, data in enumerate(messages):
        end = TEXT_PLACE + int.from_bytes(
            data[LENGTH_PLACE:TEXT_PLACE], "little" if data[1:2] == b"\x01" else "big"
        )
        groups.setdefault(data[:2] + data[LENGTH_PLACE : min(end, TEXT_STOP)], []).append(row)
    if len(groups) == 1:
        table, frame = _read_group(type_name, next(iter(groups)), messages, range(len(messages)))
        return table, [frame] * len(messages)
    table = np.zeros(len(messages), fixed_layout(type_name, 1, "<", padded=False))
    frames = [""] * len(messages)
    for head, members in groups.items():
        part, frame = _read_group(type_name, head, [messages[row] for row in members], members)
        for name in table.dtype.names or ():
            table[name][members] = part[name]
        for row in members:
            frames[row] = frame
    return table, frames


def stamps(table: Table) -> IntArray:
    """Stamps of the messages (n,) [ns since 1970]."""
    return np.asarray(table["stamp.sec"].astype(np.int64) * 10**9 + table["stamp.nanosec"])


def _read_group(
    type_name: str, head: bytes, messages: Sequence[bytes], members: Sequence[int]
) -> tuple[Table, str]:
    """Messages with the same encapsulation and frame; `members` are their rows."""
    order, text = ENCAPSULATION.get(head[:2], ""), head[2 + TEXT_PLACE - LENGTH_PLACE :]
    layout = fixed_layout(type_name, len(text), order or "<", padded=False)
    readable = order and text[-1:] in (b"\x00", b"")
    for row, data in zip(members, messages, strict=True):
        if not (readable and layout.itemsize <= len(data) <= layout.itemsize + 3):
            raise MessageError(type_name, row, len(data))
    table: Table = np.frombuffer(b"".join(data[: layout.itemsize] for data in messages), layout)
    return table, text[:-1].decode("utf-8", "replace")


@lru_cache(maxsize=256)
def fixed_layout(type_name: str, text_length: int, order: str, padded: bool) -> np.dtype[np.void]:
    """Where each number stands in a message whose frame_id has this length, its final zero counted.

    TypeError for a type with other texts, or with sequences.
    """
    found = arranged(all_fields(type_name), type_name, order, lambda place: text_length, 2**16)
    if found.lengths != (LENGTH_PLACE,) or "header.frame_id" not in found.texts:
        raise TypeError(f"{type_name} has no fixed size")
    short = replace(found, names=tuple(name.removeprefix("header.") for name in found.names))
    return short.columns(itemsize=found.size + -found.size % 4 if padded else 0)
