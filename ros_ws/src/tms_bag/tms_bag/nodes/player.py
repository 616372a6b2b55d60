"""Player: publishes the messages of a bag as they were recorded, with their timing."""

from __future__ import annotations

import sys
from contextlib import suppress
from threading import Thread
from typing import Any

from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from tms_bag.errors import RecordingError
from tms_bag.nodes import publishing
from tms_bag.nodes.diagnostics import Report, report_every_second
from tms_bag.nodes.interfaces import clock_message
from tms_bag.nodes.pacing import Pacing
from tms_bag.nodes.parameters import declare, declare_names, refuse_unknown_parameters
from tms_bag.nodes.process import run_node
from tms_bag.reader import BagReader

STEP = 0.01  # [s] how often the clock ticks, and a signal or a new rate is noticed
ACKNOWLEDGE_TIMEOUT = 10.0  # [s]


class Player(Node):
    """Node that plays a bag once, or again and again."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("player", **kwargs)
        path = declare(self, "bag", "", "bag (a folder) or .mcap file to play")
        declare(self, "rate", 1.0, "times real time", 0.01, 1000.0, read_only=False)
        offset = declare(self, "start_offset", 0.0, "start this much into the bag [s]", 0.0, 1e9)
        self._loop = declare(self, "loop", False, "start anew at the end")
        clock = declare(self, "publish_clock", False, "publish the bag's time on /clock")
        chosen = declare_names(self, "topics", "names of topics to play; empty: all")
        self._awaited = declare(
            self, "wait_for_subscriptions", 0, "subscriptions to wait for, all topics together", 0, 1000
        )
        self._patience = declare(self, "wait_timeout", 30.0, "longest wait for them [s]", 0.0, 1e6)
        refuse_unknown_parameters(self)
        if not path:
            raise RecordingError("parameter bag: expected the path of a bag, found nothing; say -p bag:=PATH")
        self._bag = BagReader(path)
        length = (self._bag.end_ns - self._bag.start_ns) / 1e9
        if offset > length:
            raise RecordingError(f"parameter start_offset: expected at most {length:g} s, found {offset:g} s")
        self._start_ns = self._bag.start_ns + round(offset * 1e9)
        self._clock_publisher = self.create_publisher(Clock, "/clock", 10) if clock else None
        self._playing = publishing.make_publishers(self, self._bag, chosen, ("/clock",) if clock else ())
        self._pacing = Pacing(self._start_ns, self._rate)
        self._played = 0
        self._spinner = SingleThreadedExecutor(context=self.context)
        self._answering = Thread(target=self._answer)  # services; messages are timed in the main thread
        report_every_second(self, self._report)

    @property
    def _rate(self) -> float:
        return float(self.get_parameter("rate").value)

    def run(self) -> None:
        """Play to the end (or, with loop, until a signal), and wait until all is acknowledged."""
        self._answering.start()
        publishing.wait_for_subscriptions(self._playing, self._awaited, self._patience, self.context)
        topics = sorted(self._playing)
        self.get_logger().info(f"playing {self._bag.path}: {', '.join(topics) or 'nothing'}")
        again = True
        while again:
            self._pacing = Pacing(self._start_ns, self._rate)
            for record in publishing.records_from(self._bag, topics, self._start_ns):
                self._pacing.wait_until(record.time_ns, STEP, self._between)
                self._playing[record.topic].publish(record.data)
                self._played += 1
            again = self._loop and self._played > 0
        for publisher in self._playing.values():
            publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE_TIMEOUT))

    def close(self) -> None:
        """Say what was played."""
        self._spinner.shutdown()
        if self._answering.is_alive():
            self._answering.join()
        self._bag.close()
        late = f"at most {self._pacing.largest_delay * 1e3:.1f} ms late"
        print(f"{self._bag.path}: {self._played} messages played, {late}", file=sys.stderr)

    def _between(self) -> None:
        """While waiting for the next message: notice a signal or a new rate, let the clock tick."""
        if not self.context.ok():
            raise ExternalShutdownException
        self._pacing.set_rate(self._rate)
        if self._clock_publisher:
            self._clock_publisher.publish(clock_message(self._pacing.now_ns()))

    def _answer(self) -> None:
        with suppress(ExternalShutdownException):
            self._spinner.add_node(self)
            self._spinner.spin()

    def _report(self) -> Report:
        delay = self._pacing.largest_delay
        subscriptions = publishing.subscription_count(self._playing)
        values = {
            "messages": self._played,
            "subscriptions": subscriptions,
            "largest delay [s]": f"{delay:.4f}",
        }
        return f"{self._played} messages of {self._bag.path}", delay < 0.1, values


def main(args: list[str] | None = None) -> int:
    """Run the player as a process."""
    return run_node(Player, args)


if __name__ == "__main__":
    sys.exit(main())
