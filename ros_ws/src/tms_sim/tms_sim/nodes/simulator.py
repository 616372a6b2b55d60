"""Simulator: publishes a scenario's run, message by message, as a bicycle with sensors would."""

from __future__ import annotations

import sys
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock as ClockMessage
from tms_bag import Record, topics
from tms_bag.nodes.diagnostics import Report, report_every_second
from tms_bag.nodes.interfaces import OVERRIDABLE, clock_message, message_class, offered_profile
from tms_bag.nodes.parameters import refuse_unknown_parameters
from tms_bag.nodes.process import run_node
from tms_bag.nodes.publishing import unacknowledged

from tms_sim.live_run import LiveRun
from tms_sim.nodes.audience import Audience
from tms_sim.nodes.controls import Controls
from tms_sim.nodes.display import Display, make_display
from tms_sim.nodes.settings import Settings, declare_settings

TICK = 0.002  # [s] of real time between looks at the clock


class Simulator(Node):
    """Node that publishes one run and ends, or waits for the next."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("simulator", **kwargs)
        self._settings: Settings = declare_settings(self)
        self._live = LiveRun(self._settings.scenario)
        self._clock_publisher = None
        if self._settings.own_clock:
            profile = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
            self._clock_publisher = self.create_publisher(ClockMessage, "/clock", profile)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._pace = steady if self._settings.own_clock else self.get_clock()
        self._outputs = {
            record.topic: self.create_publisher(
                message_class(record.type),
                record.topic.removeprefix("/"),
                offered_profile([topics.qos_of(record.topic)], 1),
                qos_overriding_options=OVERRIDABLE,
            )
            for record in {record.topic: record for record in self._live.records}.values()
        }
        self._audience = Audience(self, self._settings)
        self._display: Display | None = make_display(self, self._live.run)
        self._controls = Controls(self, self._live, self._settings.autostart, self._changed)
        refuse_unknown_parameters(self)
        report_every_second(self, self._report)
        self._warn_of_fall()

    def run(self) -> None:
        """Publish the whole run, at its pace."""
        self._audience.wait(self._outputs.values())
        self.get_logger().info(f"simulating {len(self._live.records)} messages")
        self._before = self._pace.now()
        self.create_timer(TICK, self._advance, clock=Clock(clock_type=ClockType.STEADY_TIME))
        while self._settings.stay or not self._live.finished:
            rclpy.spin_once(self, timeout_sec=0.1)
        for topic in unacknowledged(self._outputs, self._notice_signal):
            self.get_logger().warning(f"{topic}: a reliable subscriber hasn't acknowledged all messages")
        self.get_logger().info(f"published {self._live.sent} messages")

    def close(self) -> None:
        """Nothing is left behind."""

    def _notice_signal(self) -> None:
        if not self.context.ok():
            raise ExternalShutdownException

    def _advance(self) -> None:
        """Publish what has become due since the last look."""
        now = self._pace.now()
        self._before, elapsed = now, (now - self._before).nanoseconds
        if not self._controls.running:
            return
        rate = self.get_parameter("rate").value if self._settings.own_clock else 1.0
        due = self._live.advance(round(elapsed * rate))
        if self._clock_publisher:
            self._clock_publisher.publish(clock_message(self._live.now_ns))
        for record in due:
            self._outputs[record.topic].publish(record.data)
        if self._display:
            self._display.advance(self._live.now_ns, self.get_parameter("display_rate").value)

    def _changed(self, info: Record | None) -> None:
        """Show the run as it is now, and tell what it is."""
        if info:
            self._outputs[info.topic].publish(info.data)
        if self._display:
            self._display.follow(self._live.run.state)
        self._warn_of_fall()

    def _warn_of_fall(self) -> None:
        fallen = self._live.run.fallen_at
        if fallen is not None:
            self.get_logger().warning(f"the bicycle falls {fallen:.2f} s after the start; the run ends there")

    def _report(self) -> Report:
        share = 100.0 * self._live.sent / len(self._live.records)
        figures = {"messages": self._live.sent, "time_ns": self._live.now_ns, **self._live.sensor_figures()}
        return f"{share:.0f} % of the run published", True, figures


def main(args: list[str] | None = None) -> int:
    """Run the simulator as a process."""
    return run_node(Simulator, args)


if __name__ == "__main__":
    sys.exit(main())
