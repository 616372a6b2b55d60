"""Player: publishes the messages of a bag as they were recorded, with their timing."""

from __future__ import annotations

import sys
from contextlib import suppress
from typing import Any

from rclpy.node import Node

from tms_bag.nodes import publishing
from tms_bag.nodes.answering import Answering
from tms_bag.nodes.consumers import Consumers
from tms_bag.nodes.diagnostics import Report, report_every_second
from tms_bag.nodes.handled import Window
from tms_bag.nodes.parameters import refuse_unknown_parameters
from tms_bag.nodes.player_services import offer_services
from tms_bag.nodes.player_settings import declare_player_settings
from tms_bag.nodes.playing import Playing
from tms_bag.nodes.process import run_node
from tms_bag.transport import StoppedError, Transport


class Player(Node):
    """Node that plays a bag once, or again and again."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("player", **kwargs)
        self._settings = its = declare_player_settings(self)
        self._transport = Transport(its.start_ns, self._rate, its.start_paused)
        left_out = ("/clock",) if its.clock_period else ()
        consumers = Consumers(self, its.handled_topics if its.lossless else ())
        left_out += consumers.topics  # what they said when the bag was recorded isn't what they say now
        self._bag_publishers = publishing.make_publishers(self, its.bag, its.selection, left_out)
        window = Window(consumers, its.window, its.wait_timeout) if its.lossless else None
        self._playing = Playing(self, its, self._transport, self._bag_publishers, window)
        refuse_unknown_parameters(self)
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
            self._playing.play()
        for topic in publishing.unacknowledged(self._bag_publishers, self._playing.notice_signal):
            self.get_logger().warning(f"{topic}: a reliable subscriber hasn't acknowledged all messages")

    def close(self) -> None:
        """Say what was played."""
        self._answering.stop()
        self._settings.bag.close()
        sent = self._playing.sending
        late = f"at most {sent.delays.largest * 1e3:.1f} ms late"
        print(f"{self._settings.bag.path}: {sent.count} messages played, {late}", file=sys.stderr)

    def _report(self) -> Report:
        sent = self._playing.sending
        doing = "paused: " if self._transport.paused else ""
        summary = f"{doing}{sent.count} messages of {self._settings.bag.path}"
        return summary, sent.delays.largest < 0.1, sent.figures()


def main(args: list[str] | None = None) -> int:
    """Run the player as a process."""
    return run_node(Player, args)


if __name__ == "__main__":
    sys.exit(main())
