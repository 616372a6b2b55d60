"""Events of a simulated run, part of the truth: what one would not see in the samples by themselves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from tms_bag import topics
from tms_bag.messages import deserialize, message_type, serialize
from tms_bag.record import Record


@dataclass(frozen=True)
class Event:
    """Something that happened, as tms_msgs/Event tells it."""

    time_ns: int  # [ns] when it begins
    kind: str  # phase, strike, slip, joint, fault, loss, ...; docs/conventions.md lists them
    text: str  # one plain sentence
    duration: float = 0.0  # [s], 0: an instant
    figures: Mapping[str, float] = field(default_factory=dict)  # by name


def event_records(events: Iterable[Event]) -> Iterator[Record]:
    """tms_msgs/Event on /bicycle/events, in the order given."""
    kind = topics.TYPES[topics.EVENTS]
    for event in events:
        stamp = message_type("builtin_interfaces/msg/Time")(*divmod(event.time_ns, 10**9))
        message = message_type(kind)(
            header=message_type("std_msgs/msg/Header")(stamp=stamp, frame_id="world"),
            kind=event.kind,
            text=event.text,
            duration=float(event.duration),
            names=list(event.figures),
            values=np.array(list(event.figures.values()), dtype=np.float64),
        )
        yield Record("/" + topics.EVENTS, kind, event.time_ns, serialize(message), event.time_ns)


def events(records: Iterable[Record]) -> list[Event]:
    """Events of messages, in their order. Raises RecordingError."""
    messages = [deserialize(record.data, record.type) for record in records]
    return [
        Event(
            time_ns=m.header.stamp.sec * 10**9 + m.header.stamp.nanosec,
            kind=m.kind,
            text=m.text,
            duration=m.duration,
            figures=dict(zip(m.names, m.values.tolist(), strict=False)),
        )
        for m in messages
    ]
