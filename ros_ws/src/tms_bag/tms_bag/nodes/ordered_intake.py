"""Several topics, their messages in the order of sending: what a node needs that computes with them.

rclpy's executor takes one message of each topic in turn, so that at a high rate a speed that was sent after
ten samples is handled before them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile

from tms_bag.nodes.intake import Intake

PERIOD = 0.005  # [s]
LOOK_PERIOD = 0.2  # [s] how soon a best-effort publisher is listened to

Message = tuple[int, int, str, bytes]  # sent and arrived [ns], topic, CDR bytes


class OrderedIntake:
    """Calls `take(topic, bytes)` with every message, in the order of sending, some 5 ms after its arrival.

    `topics` gives type and quality of service by topic. Messages of one publishing process are in order;
    those of several as far as their clocks and the network allow. No message is waited for.
    """

    def __init__(
        self,
        node: Node,
        topics: Mapping[str, tuple[str, QoSProfile]],
        take: Callable[[str, bytes], None],
    ) -> None:
        self._take = take
        self._intakes: dict[str, Intake] = {}
        for topic, (kind, profile) in topics.items():
            self._intakes[topic] = Intake(node, topic, kind, profile.depth)
            self._intakes[topic].adapt([profile])
        self._node = node
        self._held: list[Message] = []
        self._latest_ns = 0
        self.out_of_order = 0  # messages handled after one that was sent later
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(PERIOD, self.handle, clock=steady)
        node.create_timer(LOOK_PERIOD, self._adapt, clock=steady)

    @property
    def lost(self) -> dict[str, int]:
        """Messages that were sent and did not arrive, by topic."""
        return {topic: intake.lost for topic, intake in self._intakes.items() if intake.lost}

    def handle(self) -> None:
        """Handle what has arrived."""
        # What arrives while the topics are looked at may follow something on a topic that was looked at
        # before: it waits for the next turn.
        until = time.time_ns()
        for topic, intake in self._intakes.items():
            while intake.drain(partial(self._hold, topic)):
                pass
        self._held.sort(key=lambda message: message[:2])
        ready = [message for message in self._held if message[1] <= until]
        self._held = [message for message in self._held if message[1] > until]
        self._give(ready)

    def _adapt(self) -> None:
        for topic, intake in self._intakes.items():
            intake.adapt(info.qos_profile for info in self._node.get_publishers_info_by_topic(topic))

    def _hold(self, topic: str, data: bytes, arrived_ns: int, sent_ns: int) -> None:
        self._held.append((sent_ns, arrived_ns, topic, data))

    def _give(self, messages: Iterable[Message]) -> None:
        for sent_ns, _, topic, data in messages:
            self.out_of_order += sent_ns < self._latest_ns
            self._latest_ns = max(self._latest_ns, sent_ns)
            self._take(topic, data)
