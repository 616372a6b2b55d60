"""Publishers for the topics of a bag."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator
from typing import Any

from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node

from tms_bag.channel import check_encoding
from tms_bag.errors import RecordingError
from tms_bag.nodes.interfaces import OVERRIDABLE, message_class, offered_profile
from tms_bag.reading.reader import BagReader
from tms_bag.record import Record
from tms_bag.selection import Selection

ACKNOWLEDGE_TIMEOUT = 60.0  # [s]; over a bad network it takes several heartbeats, 3 s apart
ACKNOWLEDGE_STEP = 0.05  # [s]

Publishers = dict[str, Any]  # by topic


def make_publishers(
    node: Node, bag: BagReader, selection: Selection, left_out: tuple[str, ...]
) -> Publishers:
    """A publisher for each topic that is meant, with the quality of service that was recorded.

    RecordingError if a topic that is named isn't in the bag or its type isn't installed; what isn't named is
    only warned about.
    """
    counts = {topic.name: topic.count for topic in bag.topics}
    missing = [name for name in selection.names if name not in counts]
    if missing:
        there = ", ".join(sorted(counts)) or "none"
        raise RecordingError(f"{bag.path}: no topic {', '.join(missing)}; there are: {there}")
    publishers: Publishers = {}
    for channel in bag.channels:
        name = channel.name
        if name in left_out or name in publishers or not selection.means(name, [channel.type]):
            continue
        try:
            check_encoding(channel)
            kind, profile = message_class(channel.type), offered_profile(channel.qos, counts[name])
            publishers[name] = node.create_publisher(kind, name, profile, qos_overriding_options=OVERRIDABLE)
        except RecordingError as error:
            if name in selection.names:
                raise
            node.get_logger().warning(f"{name} is not played: {error}")
        except InvalidTopicNameException:  # MCAP files of others than ROS may have it
            node.get_logger().warning(f"{name!r} is not played: no topic of ROS has such a name")
    return publishers


def subscription_count(publishers: Publishers) -> int:
    """Subscriptions that match, of all topics together."""
    return sum(int(publisher.get_subscription_count()) for publisher in publishers.values())


def wait_for_subscriptions(
    publishers: Publishers, wanted: int, timeout: float, between: Callable[[], None]
) -> None:
    """Return when `wanted` subscriptions match: messages sent before are lost for them.

    RecordingError after `timeout` [s]; `between` is called in between, and may raise to end the wait.
    """
    deadline = time.monotonic() + timeout
    while (found := subscription_count(publishers)) < wanted:
        between()
        if time.monotonic() > deadline:
            raise RecordingError(
                f"expected {wanted} subscriptions within {timeout:g} s, found {found};"
                " start the subscribers first, or lower wait_for_subscriptions"
            )
        time.sleep(0.01)


def unacknowledged(publishers: Publishers, between: Callable[[], None]) -> list[str]:
    """Wait until what was sent reliably has arrived; returns the topics where that takes too long.

    `between` is called in between, and may raise to end the wait.
    """
    late, deadline = [], time.monotonic() + ACKNOWLEDGE_TIMEOUT
    for topic, publisher in publishers.items():
        while not publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE_STEP)):
            between()
            if time.monotonic() > deadline:
                late.append(topic)
                break
    return late


def records_from(bag: BagReader, topics: Collection[str], start_ns: int, stop_ns: int) -> Iterator[Record]:
    """Messages from a time on, after those of latched topics from before it: what a late joiner would get."""
    channels = [channel for channel in bag.channels if channel.name in topics]
    latched = {c.name for c in channels if any(qos.durability == "transient_local" for qos in c.qos)}
    yield from bag.records(latched, stop_ns=start_ns)
    yield from bag.records(topics, start_ns=start_ns, stop_ns=stop_ns)
