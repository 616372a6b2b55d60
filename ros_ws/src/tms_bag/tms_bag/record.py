"""One message of a recording, still serialised, and the order of several streams of them."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Record:
    """A message as it stands in a bag."""

    topic: str  # full name with its leading slash
    type: str  # ROS type, for example sensor_msgs/msg/Imu
    time_ns: int  # [ns since 1970] when it was logged
    data: bytes  # CDR, encapsulation header included
    publish_time_ns: int | None = None  # [ns since 1970] when it was sent; None: as time_ns


def merged(*streams: Iterable[Record]) -> Iterator[Record]:
    """All records in the order of their log time; at equal times in the order of the arguments.

    Each stream must be in the order of log time itself.
    """
    return heapq.merge(*streams, key=lambda record: record.time_ns)


def arriving(records: Iterable[Record], arrival_ns: Sequence[int]) -> list[Record]:
    """The records in order of arrival: logged when they arrive [ns], sent at what was their log time.

    One arrival for each record; records that arrive together keep their order.
    """
    late = [
        Record(record.topic, record.type, int(arrival), record.data, record.time_ns)
        for record, arrival in zip(records, arrival_ns, strict=True)
    ]
    return sorted(late, key=lambda record: record.time_ns)
