"""Recorder: finds topics and their types by itself and writes their messages, as they come, into a bag."""

from __future__ import annotations

import sys
from datetime import datetime
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile

from tms_bag.channel import installed_channel
from tms_bag.errors import RecordingError
from tms_bag.nodes.diagnostics import Report, report_every_second
from tms_bag.nodes.interfaces import recorded_qos
from tms_bag.nodes.parameters import declare, declare_names, refuse_unknown_parameters
from tms_bag.nodes.process import run_node
from tms_bag.nodes.raw_subscription import subscribe_raw
from tms_bag.record import Record
from tms_bag.writer import BagWriter

LEFT_OUT = ("/rosout", "/parameter_events")  # of ROS itself; recorded when asked for by name
LOOK_PERIOD = 0.1  # [s] how soon a new topic is found
FLUSH_PERIOD = 0.5  # [s] what a kill can cost


class Recorder(Node):
    """Node that writes a bag until it is stopped."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("recorder", **kwargs)
        output = declare(
            self, "output", "", "bag (a folder) to write; empty: bag_ and the time, in this folder"
        )
        self._chosen = declare_names(self, "topics", "names of topics to record; empty: all but ROS's own")
        self._simulated_time = self.get_parameter("use_sim_time").value
        self._lost: dict[str, int] = {}
        self._told: dict[str, int] = {}  # losses that the user knows already
        self._passed_over: set[str] = set()
        refuse_unknown_parameters(self)
        self._bag = BagWriter(Path(output or f"bag_{datetime.now():%Y-%m-%d_%H-%M-%S}"), live=True)
        self._bag.__enter__()
        self._look_for_topics()
        self.create_timer(LOOK_PERIOD, self._look_for_topics)
        self.create_timer(FLUSH_PERIOD, self._bag.flush)
        report_every_second(self, self._report)
        self.get_logger().info(f"recording to {self._bag.path}")

    def run(self) -> None:
        """Record until a signal."""
        rclpy.spin(self)

    def close(self) -> None:
        """Close the bag and say what is in it."""
        self._bag.__exit__(None, None, None)
        counts, lost = self._bag.counts, sum(self._lost.values())
        losses = f", {lost} lost" if lost else ""
        print(
            f"{self._bag.path}: {sum(counts.values())} messages of {len(counts)} topics{losses}",
            file=sys.stderr,
        )

    def _look_for_topics(self) -> None:
        for name, types in self.get_topic_names_and_types():
            if name in self._bag.counts or name in self._passed_over or not self._wanted(name):
                continue
            offered = [info.qos_profile for info in self.get_publishers_info_by_topic(name)]
            if not offered:  # somebody listens, nobody speaks
                continue
            try:
                self._record(name, types, offered)
                self.get_logger().info(f"recording {name} [{types[0]}]")
            except RecordingError as error:
                self._passed_over.add(name)
                self.get_logger().warning(f"{name} is not recorded: {error}")

    def _wanted(self, name: str) -> bool:
        if self._chosen:
            return name in self._chosen
        return name not in LEFT_OUT and not any(part.startswith("_") for part in name.split("/"))

    def _record(self, name: str, types: list[str], offered: list[QoSProfile]) -> None:
        if len(types) > 1:
            raise RecordingError(
                f"expected one type, found {', '.join(types)}; give the topics different names"
            )
        type_name = types[0]
        channel = installed_channel(name, type_name, tuple(dict.fromkeys(map(recorded_qos, offered))))

        def take(data: bytes, received: int, sent: int) -> None:
            if self._simulated_time:  # then the bag tells simulated time, as with rosbag2's --use-sim-time
                received = sent = self.get_clock().now().nanoseconds
            self._bag.write(Record(name, type_name, received, data, sent))

        subscribe_raw(self, name, type_name, offered, take, lambda count: self._lost.update({name: count}))
        self._bag.add_channel(channel)

    def _report(self) -> Report:
        if self._lost != self._told:
            self._told = dict(self._lost)
            self.get_logger().warning(f"lost messages: {self._told}")
        counts = self._bag.counts
        losses = {f"{name} lost": count for name, count in self._lost.items()}
        return f"{sum(counts.values())} messages in {self._bag.path}", not self._lost, {**counts, **losses}


def main(args: list[str] | None = None) -> int:
    """Run the recorder as a process."""
    return run_node(Recorder, args)


if __name__ == "__main__":
    sys.exit(main())
