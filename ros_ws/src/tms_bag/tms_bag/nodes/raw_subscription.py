"""A subscription that hands over messages as they come over the wire, and doesn't fall behind in bursts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile

from tms_bag.nodes.interfaces import message_class, requested_profile

DEPTH = 5000  # [messages] the longest backlog: 12 s at 400 Hz
LONGEST_TURN = 1000  # [messages] of one topic, before others have their turn

# CDR bytes, time of arrival and of sending [ns since 1970].
Take = Callable[[bytes, int, int], None]


def subscribe_raw(
    node: Node,
    name: str,
    type_name: str,
    offered: Sequence[QoSProfile],
    take: Take,
    lost: Callable[[int], None],
) -> None:
    """Call `take` with every message of a topic, and `lost` with the number of lost messages when it grows.

    RecordingError if the type isn't installed.
    """
    kind = message_class(type_name)

    def on_message(data: bytes, info: dict[str, Any]) -> None:
        take(data, info["received_timestamp"], info["source_timestamp"])
        # The executor hands over one message per turn; what else has arrived is taken here, which is faster.
        handle = subscription.handle
        with handle:
            for _ in range(LONGEST_TURN):
                taken = handle.take_message(kind, True)
                if taken is None:
                    return
                take(taken[0], taken[1]["received_timestamp"], taken[1]["source_timestamp"])

    events = SubscriptionEventCallbacks(message_lost=lambda event: lost(event.total_count))
    profile = requested_profile(offered, DEPTH)
    subscription = node.create_subscription(kind, name, on_message, profile, event_callbacks=events, raw=True)
