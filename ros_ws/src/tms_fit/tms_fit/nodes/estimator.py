"""Estimator node: filter state at every IMU sample, estimates of each strike."""

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
from tms_fit.speed_profile import FIXED, MEASURED
from tms_fit.speed_source import live_speed_sentence, other_speed_topics
from tms_fit.streaming.live_fit import INPUTS, LiveFit

QUEUE_DEPTH = 2000  # messages that arrive during a fit of a few tenths of a second


class Estimator(Node):
    """Node that passes messages to a LiveFit and publishes its results."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("estimator", **kwargs)
        settings = declare_settings(self)
        self._idle = settings.idle
        self._fit = LiveFit(settings.fit, settings.bicycle, settings.reorder_window, settings.preview_period)
        self._last = time.monotonic()
        # Estimates are latched for late subscribers. Filter states are a stream like a sensor's, published in
        # bursts as large as the queue of samples.
        latched = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        offered = {
            ESTIMATE: (ESTIMATE_TYPE, latched),
            FILTER_STATE: (FILTER_STATE_TYPE, QoSProfile(depth=QUEUE_DEPTH)),
        }
        self._outputs = {
            f"/{topic}": self.create_publisher(
                message_class(kind), topic, profile, qos_overriding_options=OVERRIDABLE
            )
            for topic, (kind, profile) in offered.items()
        }
        refuse_unknown_parameters(self)
        self._handled = HandledReport(self, INPUTS)
        self._intake = OrderedIntake(self, {topic: _wanted(topic) for topic in INPUTS}, self._process)
        offer_refit(self, self._fit)
        self._bag_fits = BagFits(self, settings.fit)
        self.create_timer(0.2, self._finish_when_idle, clock=Clock(clock_type=ClockType.STEADY_TIME))
        report_every_second(self, self._report)
        self.get_logger().info("estimator ready")

    def run(self) -> None:
        """Spin until a signal."""
        rclpy.spin(self)

    def close(self) -> None:
        """Stop the fits of bags and print the counts of messages."""
        self._bag_fits.close()
        print(f"estimator: {self._counts}", file=sys.stderr)

    @property
    def _counts(self) -> dict[str, int]:
        late = self._intake.out_of_order
        return self._fit.diagnostics | ({"out_of_order": late} if late else {})

    def _process(self, topic: str, data: bytes) -> None:
        self._last = time.monotonic()
        self._publish(self._fit.process(topic, data))
        self._handled.add(topic)

    def _finish_when_idle(self) -> None:
        self._intake.handle()  # queued messages are no silence
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
        speed, speed_is_known = self._speed_report()
        lost = {f"{topic} lost": count for topic, count in self._intake.lost.items()}
        return (
            f"{text}; {speed}" if speed else text,
            bool(self._fit.bicycle) and not lost and speed_is_known,
            {**self._counts, **lost, **self._fit.parameter_states},
        )

    def _speed_report(self) -> tuple[str, bool]:
        """Which speed is used, once there are IMU samples; and whether no other topic may hold it."""
        if not self._fit.bicycle or not self._fit.counts[topics.IMU]:
            return "", True
        source, others = self._fit.speed_source, []
        if source not in (FIXED, MEASURED):
            read = [self.resolve_topic_name(topic) for topic in (topics.SPEED, topics.SPEED_COVARIANCE)]
            others = other_speed_topics(self.get_topic_names_and_types(), read)
        return live_speed_sentence(source, topics.SPEED, others), not others


def _wanted(topic: str) -> tuple[str, QoSProfile]:
    """Type of a topic, and its requested QoS profile while it has no publisher."""
    latched = topic == topics.RUN_INFO
    profile = QoSProfile(
        depth=10 if latched else QUEUE_DEPTH,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
    return topics.TYPES[topic], profile


def main(args: list[str] | None = None) -> int:
    """Run the estimator as a process."""
    return run_node(Estimator, args)


if __name__ == "__main__":
    sys.exit(main())
