"""The messages of one topic as columns of numbers, to be changed and written again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tms_bag import Record, RecordingError
from tms_bag.reading.tables import new_table, read_table, rows, stamps

Rows = NDArray[np.int64] | NDArray[np.bool_] | slice


@dataclass(frozen=True, eq=False)
class Stream:
    """Messages of one topic, in the order of the recording."""

    topic: str  # with its leading slash
    type: str
    frame_id: str
    order: NDArray[np.int64]  # (n,) place of each message in the whole recording
    log_ns: NDArray[np.int64]  # (n,) [ns] when it was logged
    sent_ns: NDArray[np.int64]  # (n,) [ns] when it was sent
    stamp_ns: NDArray[np.int64]  # (n,) [ns] header.stamp
    columns: dict[str, NDArray[Any]]  # (n,) or (n, k) each, by the names of the message's numbers

    def rows(self, chosen: Rows) -> Stream:
        """Some of the messages, or some twice."""
        return replace(
            self,
            order=self.order[chosen],
            log_ns=self.log_ns[chosen],
            sent_ns=self.sent_ns[chosen],
            stamp_ns=self.stamp_ns[chosen],
            columns={name: values[chosen] for name, values in self.columns.items()},
        )

    def axes(self, quantity: str, axis: str = "all") -> list[str]:
        """Columns of a quantity: those of its x, y and z, or itself. Raises RecordingError."""
        names = [f"{quantity}.{letter}" for letter in "xyz" if axis in (letter, "all")]
        found = [quantity] if quantity in self.columns else [name for name in names if name in self.columns]
        if not found:
            numbers = sorted(name for name, values in self.columns.items() if values.dtype.kind == "f")
            raise RecordingError(
                f"{self.topic}: expected a quantity {quantity} with axis {axis}, found {', '.join(numbers)}"
            )
        return found

    def with_columns(self, changed: dict[str, NDArray[Any]]) -> Stream:
        """The same messages with other numbers."""
        return replace(self, columns={**self.columns, **changed})


def read_stream(records: Sequence[tuple[int, Record]]) -> Stream:
    """Stream of the records of one topic, each with its place in the recording. Raises RecordingError.

    For types of a header and nothing but numbers behind it.
    """
    first = records[0][1]
    try:
        table, frames = read_table(first.type, [record.data for _, record in records])
    except TypeError as error:
        raise RecordingError(
            f"{first.topic}: expected messages of numbers, found {first.type}: {error}"
        ) from error
    if len(set(frames)) > 1:
        raise RecordingError(f"{first.topic}: expected one frame_id, found {', '.join(sorted(set(frames)))}")
    names = [name for name in table.dtype.names or () if not name.startswith("stamp.")]
    return Stream(
        topic=first.topic,
        type=first.type,
        frame_id=frames[0],
        order=np.array([place for place, _ in records]),
        log_ns=np.array([record.time_ns for _, record in records]),
        sent_ns=np.array(
            [
                record.time_ns if record.publish_time_ns is None else record.publish_time_ns
                for _, record in records
            ]
        ),
        stamp_ns=stamps(table),
        columns={name: np.array(table[name]) for name in names},
    )


def write_stream(stream: Stream) -> Iterator[tuple[int, Record]]:
    """The messages again, each with its place in the recording."""
    if len(stream.stamp_ns) and stream.stamp_ns.min() < 0:
        raise RecordingError(
            f"{stream.topic}: expected stamps from 0 on (ROS), found {stream.stamp_ns.min()} ns; let the"
            " clock jump less far back"
        )
    table = new_table(stream.type, stream.stamp_ns, stream.frame_id)
    for name, values in stream.columns.items():
        table[name] = values
    columns = (stream.order.tolist(), stream.log_ns.tolist(), stream.sent_ns.tolist(), rows(table))
    for place, logged, sent, data in zip(*columns, strict=True):
        yield place, Record(stream.topic, stream.type, logged, data, sent)
