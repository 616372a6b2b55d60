"""Nodes that say on `~/handled` what they hear, and how many messages of it they have handled."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from tms_msgs.msg import Handled

LATEST = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Consumers:
    """Those that report on `topics`, as far as this node has heard of them."""

    def __init__(self, node: Node, topics: Sequence[str]) -> None:
        self._node = node
        self.topics = tuple(node.resolve_topic_name(topic) for topic in topics)
        self.handled: dict[str, Counter[str]] = {}  # messages handled, by report and topic
        self._names: dict[str, str] = {}  # of the nodes, by report
        for topic in self.topics:
            node.create_subscription(Handled, topic, self._hearer(topic), LATEST)

    def lacking(self, publishers: Iterable[Any]) -> list[str]:
        """What must be found before none of them misses a message: reports, and subscriptions."""
        silent = [topic for topic in self.topics if topic not in self.handled]
        return silent + [
            f"{name} on {publisher.topic_name}"
            for publisher in publishers
            for name in self._unknown_to(publisher)
        ]

    def _unknown_to(self, publisher: Any) -> list[str]:
        topic = publisher.topic_name
        handled = list(self.handled.items())  # a thread of the player's may be adding to it
        wanting = [self._names[report] for report, counts in handled if topic in counts]
        if not wanting:
            return []
        infos = self._node.get_subscriptions_info_by_topic(topic)
        known = {f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos}
        unknown = [name for name in wanting if name not in known]
        # The graph may know of a subscription a moment before the publisher does.
        return unknown or (wanting if publisher.get_subscription_count() < len(wanting) else [])

    def _hearer(self, report: str) -> Callable[[Handled], None]:
        def hear(message: Handled) -> None:
            self._names[report] = message.node
            self.handled[report] = Counter(dict(zip(message.topics, message.counts, strict=False)))

        return hear
