"""The bag's time on /clock, while it is played."""

from __future__ import annotations

import time

from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from tms_bag.nodes.interfaces import clock_message
from tms_bag.transport import Transport


class ClockTicks:
    """Publishes where a player stands every `period` [s] of real time, no later than `end_ns`; 0: never."""

    def __init__(self, node: Node, transport: Transport, period: float, end_ns: int) -> None:
        self._transport, self._period, self._end_ns = transport, period, end_ns
        self._publisher = node.create_publisher(Clock, "/clock", 10) if period else None
        self._due = 0.0

    def tick_when_due(self) -> None:
        """To be called more often than the clock ticks."""
        if self._publisher and time.monotonic() >= self._due:
            self._due = time.monotonic() + self._period
            self._publisher.publish(clock_message(min(self._transport.now_ns(), self._end_ns)))
