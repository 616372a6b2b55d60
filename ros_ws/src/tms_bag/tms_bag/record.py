"""One message of a recording, still serialised, and the order of several streams of them."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
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
