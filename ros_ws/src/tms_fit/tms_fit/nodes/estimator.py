"""Estimator: filter state after every IMU sample, estimates of the initial lean rate after every strike."""

from __future__ import annotations

import sys
import time
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from tms_bag import topics
from tms_bag.nodes.diagnostics import Report, report_every_second
from tms_bag.nodes.handled import HandledReport
from tms_bag.nodes.interfaces import OVERRIDABLE, message_class
from tms_bag.nodes.ordered_intake import OrderedIntake
from tms_bag.nodes.parameters import refuse_unknown_parameters
from tms_bag.nodes.process import run_node

from tms_fit.messages import ESTIMATE, ESTIMATE_TYPE, FILTER_STATE, FILTER_STATE_TYPE
from tms_fit.nodes.bag_fits import BagFits
from tms_fit.nodes.refit import offer_refit
from tms_fit.nodes.settings import declare_settings
from tms_fit.streaming.live_fit import INPUTS, LiveFit

DEPTH = 2000  # [messages]; a fit takes a few tenths of a second, in which no sample must be lost


class Estimator(Node):
    """Node that carries messages to and from a LiveFit."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("estimator", **kwargs)
        settings = declare_settings(self)
        self._idle = settings.idle
        self._fit = LiveFit(settings.fit, settings.bicycle, settings.reorder_window, settings.preview_period)
        self._last = time.monotonic()
        # Estimates are few and must not be missed by who comes late; filter states are a stream like any
        # sensor's, and come as many at a time as samples have waited.
        latched = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        offered = {
            ESTIMATE: (ESTIMATE_TYPE, latched),
            FILTER_STATE: (FILTER_STATE_TYPE, QoSProfile(depth=DEPTH)),
        }
        self._outputs = {
            f"/{topic}": self.create_publisher(
                message_class(kind), topic, profile, qos_overriding_options=OVERRIDABLE
            )
            for topic, (kind, profile) in offered.items()
        }
        refuse_unknown_parameters(self)
        self._handled = HandledReport(self, INPUTS)
        self._intake = OrderedIntake(self, {topic: _wanted(topic) for topic in INPUTS}, self._take)
        offer_refit(self, self._fit)
        self._bag_fits = BagFits(self, settings.fit)
        self.create_timer(0.2, self._finish_when_idle, clock=Clock(clock_type=ClockType.STEADY_TIME))
        report_every_second(self, self._report)
        self.get_logger().info("estimator ready")

    def run(self) -> None:
        """Work until a signal."""
        rclpy.spin(self)

    def close(self) -> None:
        """Say what came."""
        self._bag_fits.close()
        print(f"estimator: {self._counts}", file=sys.stderr)

    @property
    def _counts(self) -> dict[str, int]:
        late = self._intake.out_of_order
        return self._fit.diagnostics | ({"out_of_order": late} if late else {})

    def _take(self, topic: str, data: bytes) -> None:
        self._last = time.monotonic()
        self._publish(self._fit.process(topic, data))
        self._handled.add(topic)

    def _finish_when_idle(self) -> None:
        self._intake.handle()  # what waits since this process was held up is no silence
        if time.monotonic() - self._last > self._idle:
            self._last = float("inf")
            self._publish(self._fit.finish())

    def _publish(self, records: list[Any]) -> None:
        for record in records:
            self._outputs[record.topic].publish(record.data)

    def _report(self) -> Report:
        text = f"bicycle {self._fit.bicycle}"
        if not self._fit.bicycle:
            text = "waiting for run_info, or set the parameter bicycle"
            if self._fit.counts["unknown_bicycle"]:
                text = "run_info names no bicycle of the catalogue: set the parameter bicycle"
        lost = {f"{topic} lost": count for topic, count in self._intake.lost.items()}
        return (
            text,
            bool(self._fit.bicycle) and not lost,
            {**self._counts, **lost, **self._fit.parameter_states},
        )


def _wanted(topic: str) -> tuple[str, QoSProfile]:
    """Type of a topic, and what is asked of its publishers as long as nobody publishes."""
    latched = topic == topics.RUN_INFO
    profile = QoSProfile(
        depth=10 if latched else DEPTH,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
    return topics.TYPES[topic], profile


def main(args: list[str] | None = None) -> int:
    """Run the estimator as a process."""
    return run_node(Estimator, args)


if __name__ == "__main__":
    sys.exit(main())
