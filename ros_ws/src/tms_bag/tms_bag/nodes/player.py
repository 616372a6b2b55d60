"""Player: publishes the messages of a bag as they were recorded, with their timing."""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from threading import Thread
from typing import Any

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from tms_bag.delays import Delays
from tms_bag.nodes import publishing
from tms_bag.nodes.diagnostics import Report, report_every_second
from tms_bag.nodes.handled import Window
from tms_bag.nodes.interfaces import clock_message
from tms_bag.nodes.parameters import refuse_unknown_parameters
from tms_bag.nodes.player_services import offer_services
from tms_bag.nodes.player_settings import declare_player_settings
from tms_bag.nodes.process import run_node
from tms_bag.record import Record
from tms_bag.transport import Transport

STEP = 0.01  # [s] how often a signal is noticed


class Player(Node):
    """Node that plays a bag once, or again and again."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("player", **kwargs)
        self._settings = its = declare_player_settings(self)
        self._clock_publisher = self.create_publisher(Clock, "/clock", 10) if its.clock_period else None
        left_out = ("/clock",) if self._clock_publisher else ()
        self._playing = publishing.make_publishers(self, its.bag, its.selection, left_out)
        refuse_unknown_parameters(self)
        self._transport = Transport(its.start_ns, self._rate, its.start_paused)
        self._window = (
            Window(self, its.handled_topics, its.window, its.wait_timeout) if its.lossless else None
        )
        self._delays, self._played, self._tick_at = Delays(), 0, 0.0
        offer_services(self, self._transport, its.start_ns, its.end_ns)
        self.add_post_set_parameters_callback(lambda changed: self._transport.set_rate(self._rate))
        self._spinner = SingleThreadedExecutor(context=self.context)
        self._answering = Thread(target=self._answer)  # services; messages are timed in the main thread
        report_every_second(self, self._report)

    @property
    def _rate(self) -> float:
        return float(self.get_parameter("rate").value)

    def run(self) -> None:
        """Play to the end (or, with loop, until a signal), and wait until all is acknowledged, or handled."""
        its = self._settings
        self._answering.start()
        publishing.wait_for_subscriptions(
            self._playing, its.wait_for_subscriptions, its.wait_timeout, self.context
        )
        if self._window:
            self._window.begin(self._between)
        self.get_logger().info(f"playing {its.bag.path}: {', '.join(sorted(self._playing)) or 'nothing'}")
        self._transport.seek(its.start_ns)
        while (start_ns := self._transport.take_target()) is not None:
            if self._play_from(start_ns) and its.loop and self._played:
                self._transport.seek(its.start_ns)
        if self._window:
            self._window.wait_for_all(self._between)
        for topic in publishing.unacknowledged(self._playing, self._between):
            self.get_logger().warning(f"{topic}: a reliable subscriber hasn't acknowledged all messages")

    def close(self) -> None:
        """Say what was played."""
        self._spinner.shutdown()
        if self._answering.is_alive():
            self._answering.join()
        self._settings.bag.close()
        late = f"at most {self._delays.largest * 1e3:.1f} ms late"
        print(f"{self._settings.bag.path}: {self._played} messages played, {late}", file=sys.stderr)

    def _play_from(self, start_ns: int) -> bool:
        """Play from a time of the bag [ns] on; returns whether the end was reached."""
        its = self._settings
        for record in publishing.records_from(its.bag, sorted(self._playing), start_ns, its.end_ns + 1):
            late = self._transport.wait_until(max(record.time_ns, start_ns), STEP, self._between)
            if late is None:
                return False
            self._publish(record)
            if record.time_ns >= start_ns:  # latched messages from before the start are not late
                self._delays.add(late)
        return True

    def _publish(self, record: Record) -> None:
        if self._window:
            self._window.wait_for_room(record.topic, self._between)
            self._window.count(record.topic)
            self._transport.stand_at(record.time_ns)
        self._playing[record.topic].publish(record.data)
        self._played += 1

    def _between(self) -> None:
        """While waiting for the next message: notice a signal, let the clock tick."""
        if not self.context.ok():
            raise ExternalShutdownException
        if self._clock_publisher and time.monotonic() >= self._tick_at:
            self._tick_at = time.monotonic() + self._settings.clock_period
            self._clock_publisher.publish(clock_message(self._transport.now_ns()))

    def _answer(self) -> None:
        with suppress(ExternalShutdownException):
            self._spinner.add_node(self)
            self._spinner.spin()

    def _report(self) -> Report:
        late = self._delays
        values: dict[str, object] = {
            "messages": self._played,
            "subscriptions": publishing.subscription_count(self._playing),
            "rate": self._transport.rate,
            "median delay [s]": f"{late.quantile(0.5):.6f}",
            "99 % delay [s]": f"{late.quantile(0.99):.6f}",
            "largest delay [s]": f"{late.largest:.4f}",
        }
        doing = "paused: " if self._transport.paused else ""
        return f"{doing}{self._played} messages of {self._settings.bag.path}", late.largest < 0.1, values


def main(args: list[str] | None = None) -> int:
    """Run the player as a process."""
    return run_node(Player, args)


if __name__ == "__main__":
    sys.exit(main())
