"""A bag on its way out: from its start to its end, once or again and again."""

from __future__ import annotations

import time

from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from tms_bag.nodes import publishing
from tms_bag.nodes.clock_ticks import ClockTicks
from tms_bag.nodes.handled import Window
from tms_bag.nodes.listeners import wait_until_known
from tms_bag.nodes.player_settings import PlayerSettings
from tms_bag.nodes.sending import Sending
from tms_bag.transport import StoppedError, Transport

STEP = 0.01  # [s] how often a signal is noticed
LEAST_ROUND = 0.01  # [s] of real time; a bag of one message would otherwise be sent as fast as can be


class Playing:
    """Plays a bag as a transport says, with /clock. StoppedError in whatever waits after ~/stop."""

    def __init__(
        self,
        node: Node,
        its: PlayerSettings,
        transport: Transport,
        publishers: publishing.Publishers,
        window: Window | None,
    ) -> None:
        self._node, self._its, self._transport, self._publishers = node, its, transport, publishers
        self._ticks = ClockTicks(node, transport, its.clock_period, its.end_ns)
        self.sending = Sending(publishers, window, transport, self._between)

    def play(self) -> None:
        """Wait for those who listen, then play to the end, or without end in a loop."""
        its = self._its
        publishing.wait_for_subscriptions(
            self._publishers, its.wait_for_subscriptions, its.wait_timeout, self._notice_end
        )
        self.sending.begin(self._notice_end)
        if its.lossless or its.wait_for_subscriptions:
            wait_until_known(self._node, self._publishers, self._notice_end)
        topics = ", ".join(sorted(self._publishers)) or "nothing"
        self._node.get_logger().info(f"playing {its.bag.path}: {topics}")
        began = self._begin(time.monotonic() + its.delay)
        while (start_ns := self._transport.take_target()) is not None:
            if self._play_from(start_ns) and its.loop and self.sending.count:
                began = self._begin(max(began + LEAST_ROUND, time.monotonic() + its.delay))
        self.sending.finish()

    def notice_signal(self) -> None:
        """Raise ExternalShutdownException after a signal."""
        if not self._node.context.ok():
            raise ExternalShutdownException

    def _begin(self, due: float) -> float:
        """At a time [s] of the monotonic clock go to the start, or where ~/seek said; returns the time."""
        while (left := due - time.monotonic()) > 0.0:
            self._notice_end()
            time.sleep(min(left, STEP))
        self._transport.begin(self._its.start_ns)
        return time.monotonic()

    def _play_from(self, start_ns: int) -> bool:
        """Play from a time of the bag [ns] on; returns whether the end was reached."""
        its = self._its
        for record in publishing.records_from(its.bag, sorted(self._publishers), start_ns, its.end_ns + 1):
            late = self._transport.wait_until(max(record.time_ns, start_ns), STEP, self._between)
            if late is None:
                return False
            # Latched messages from before the start belong to no time.
            self.sending.send(record, late if record.time_ns >= start_ns else None)
        return True

    def _between(self) -> None:
        """While playing: notice ~/stop and a signal, let the clock tick."""
        self._notice_end()
        self._ticks.tick_when_due()

    def _notice_end(self) -> None:
        if self._transport.stopped:
            raise StoppedError
        self.notice_signal()
