"""Player: publishes the messages of a bag as they were recorded, with their timing."""

from __future__ import annotations

import sys
from contextlib import suppress
from typing import Any

from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from tms_bag.nodes import publishing
from tms_bag.nodes.answering import Answering
from tms_bag.nodes.clock_ticks import ClockTicks
from tms_bag.nodes.consumers import Consumers
from tms_bag.nodes.diagnostics import Report, report_every_second
from tms_bag.nodes.handled import Window
from tms_bag.nodes.listeners import wait_until_known
from tms_bag.nodes.parameters import refuse_unknown_parameters
from tms_bag.nodes.player_services import offer_services
from tms_bag.nodes.player_settings import declare_player_settings
from tms_bag.nodes.process import run_node
from tms_bag.nodes.sending import Sending
from tms_bag.transport import StoppedError, Transport

STEP = 0.01  # [s] how often a signal is noticed


class Player(Node):
    """Node that plays a bag once, or again and again."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("player", **kwargs)
        self._settings = its = declare_player_settings(self)
        self._transport = Transport(its.start_ns, self._rate, its.start_paused)
        self._ticks = ClockTicks(self, self._transport, its.clock_period, its.end_ns)
        left_out = ("/clock",) if its.clock_period else ()
        consumers = Consumers(self, its.handled_topics if its.lossless else ())
        left_out += consumers.topics  # what they said when the bag was recorded isn't what they say now
        self._playing = publishing.make_publishers(self, its.bag, its.selection, left_out)
        refuse_unknown_parameters(self)
        window = Window(consumers, its.window, its.wait_timeout) if its.lossless else None
        self._sending = Sending(self._playing, window, self._transport, self._between)
        offer_services(self, self._transport, its.start_ns, its.end_ns)
        self.add_post_set_parameters_callback(lambda changed: self._transport.set_rate(self._rate))
        self._answering = Answering(self)  # messages are timed in the main thread
        report_every_second(self, self._report)

    @property
    def _rate(self) -> float:
        return float(self.get_parameter("rate").value)

    def run(self) -> None:
        """Play until the end, ~/stop or a signal; but for a signal, wait until all is acknowledged."""
        self._answering.start()
        with suppress(StoppedError):
            self._play()
        for topic in publishing.unacknowledged(self._playing, self._notice_signal):
            self.get_logger().warning(f"{topic}: a reliable subscriber hasn't acknowledged all messages")

    def close(self) -> None:
        """Say what was played."""
        self._answering.stop()
        self._settings.bag.close()
        late = f"at most {self._sending.delays.largest * 1e3:.1f} ms late"
        print(f"{self._settings.bag.path}: {self._sending.count} messages played, {late}", file=sys.stderr)

    def _play(self) -> None:
        its = self._settings
        publishing.wait_for_subscriptions(
            self._playing, its.wait_for_subscriptions, its.wait_timeout, self._notice_end
        )
        self._sending.begin(self._notice_end)
        if its.lossless or its.wait_for_subscriptions:
            wait_until_known(self, self._playing, self._notice_end)
        self.get_logger().info(f"playing {its.bag.path}: {', '.join(sorted(self._playing)) or 'nothing'}")
        self._transport.begin(its.start_ns)
        while (start_ns := self._transport.take_target()) is not None:
            if self._play_from(start_ns) and its.loop and self._sending.count:
                self._transport.seek(its.start_ns)
        self._sending.finish()

    def _play_from(self, start_ns: int) -> bool:
        """Play from a time of the bag [ns] on; returns whether the end was reached."""
        its = self._settings
        for record in publishing.records_from(its.bag, sorted(self._playing), start_ns, its.end_ns + 1):
            late = self._transport.wait_until(max(record.time_ns, start_ns), STEP, self._between)
            if late is None:
                return False
            # Latched messages from before the start belong to no time.
            self._sending.send(record, late if record.time_ns >= start_ns else None)
        return True

    def _between(self) -> None:
        """While playing: notice ~/stop and a signal, let the clock tick."""
        self._notice_end()
        self._ticks.tick_when_due()

    def _notice_end(self) -> None:
        if self._transport.stopped:
            raise StoppedError
        self._notice_signal()

    def _notice_signal(self) -> None:
        if not self.context.ok():
            raise ExternalShutdownException

    def _report(self) -> Report:
        doing = "paused: " if self._transport.paused else ""
        summary = f"{doing}{self._sending.count} messages of {self._settings.bag.path}"
        return summary, self._sending.delays.largest < 0.1, self._sending.figures()


def main(args: list[str] | None = None) -> int:
    """Run the player as a process."""
    return run_node(Player, args)


if __name__ == "__main__":
    sys.exit(main())
