"""How many messages a node has handled: said by the node, and heard by a player that loses nothing."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from tms_msgs.msg import Handled

from tms_bag.errors import RecordingError
from tms_bag.nodes.consumers import LATEST, Consumers

PERIOD = 0.05  # [s] at the latest
EVERY = 20  # [messages] so many may be handled before it is said


class HandledReport:
    """Says on `~/handled` what has been handled: every 20 messages, and 50 ms after the last."""

    def __init__(self, node: Node, topics: Sequence[str]) -> None:
        self._node = node
        self._counts = {node.resolve_topic_name(topic): 0 for topic in topics}
        self._names = {topic: node.resolve_topic_name(topic) for topic in topics}
        self._unsaid = 0
        self._publisher = node.create_publisher(Handled, "~/handled", LATEST)
        self._say()
        node.create_timer(PERIOD, self._say_when_due, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def add(self, topic: str) -> None:
        """A message of a topic has been handled."""
        self._counts[self._names[topic]] += 1
        self._unsaid += 1
        if self._unsaid >= EVERY:
            self._say()

    def _say_when_due(self) -> None:
        if self._unsaid:
            self._say()

    def _say(self) -> None:
        message = Handled(node=self._node.get_fully_qualified_name())
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.topics, message.counts = list(self._counts), list(self._counts.values())
        self._publisher.publish(message)
        self._unsaid = 0


class Window:
    """Lets only so many messages be under way to the consumers. Topics have the names they are sent by."""

    def __init__(self, consumers: Consumers, size: int, patience: float) -> None:
        self._consumers, self._size, self._patience = consumers, size, patience
        self._before: dict[str, Counter[str]] = {}  # handled when the replay began
        self._sent: Counter[str] = Counter()

    def begin(self, publishers: Iterable[Any], between: Callable[[], None]) -> None:
        """Wait until every consumer has reported and is known to all publishers that it wants to hear.

        RecordingError after the patience [s].
        """
        sources = list(publishers)
        self._wait(lambda: not self._consumers.lacking(sources), between)
        self._before = {topic: Counter(counts) for topic, counts in self._consumers.handled.items()}

    def count(self, topic: str) -> None:
        """A message has been sent."""
        self._sent[topic] += 1

    def wait_for_room(self, topic: str, between: Callable[[], None]) -> None:
        """Wait until another message of the topic may be sent."""
        self._wait(lambda: self._under_way(topic) < self._size, between)

    def wait_for_all(self, between: Callable[[], None]) -> None:
        """Wait until everything that was sent has been handled."""
        self._wait(lambda: not any(self._under_way(topic) for topic in self._sent), between)

    def _under_way(self, topic: str) -> int:
        """Messages that the slowest of the nodes that want the topic has not handled."""
        open_ = [
            self._sent[topic] - counts[topic] + self._before[reporter][topic]
            for reporter, counts in self._consumers.handled.items()
            if topic in counts
        ]
        return max(open_, default=0)

    def _wait(self, condition: Callable[[], bool], between: Callable[[], None]) -> None:
        deadline, progress = time.monotonic() + self._patience, self._progress()
        while not condition():
            between()
            if self._progress() != progress:
                deadline, progress = time.monotonic() + self._patience, self._progress()
            if time.monotonic() > deadline:
                open_ = {topic: n for topic in self._sent if (n := self._under_way(topic))}
                raise RecordingError(
                    f"expected {', '.join(self._consumers.topics)} to say what has been handled, found"
                    f" nothing new for {self._patience:g} s (under way: {open_ or 'nothing'});"
                    " is the consumer running?"
                )
            time.sleep(0.0005)

    def _progress(self) -> int:
        return sum(sum(counts.values()) for counts in list(self._consumers.handled.values()))
