"""Simulator: publishes a scenario's run, message by message, as a bicycle with sensors would."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock as ClockMessage
from tms_bag import RecordingError, topics
from tms_bag.nodes.diagnostics import Report, report_every_second
from tms_bag.nodes.interfaces import message_class, offered_profile
from tms_bag.nodes.parameters import declare, refuse_unknown_parameters
from tms_bag.nodes.process import run_node
from tms_model import ParameterError

from tms_sim.keys import KEYS
from tms_sim.run import simulate
from tms_sim.scenario import Scenario, load_scenario

TICK = 0.002  # [s] of real time between looks at the clock
# [ns] of simulated time published at once: a late tick must not outrun the subscribers' history.
LARGEST_STEP = 250_000_000


class Simulator(Node):
    """Node that publishes one run and ends."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("simulator", **kwargs)
        scenario = self._scenario()
        declare(self, "rate", 1.0, "simulated seconds per real second", 0.01, 100.0, read_only=False)
        clock = declare(
            self,
            "clock",
            "simulated",
            "'simulated': own time from start_time_ns on, published on /clock; 'node': the node's",
        )
        if clock not in ("simulated", "node"):
            raise ParameterError(f"parameter clock: expected 'simulated' or 'node', found {clock!r}")
        self._wanted = declare(
            self, "wait_for_subscribers", 0, "subscribers of each topic to wait for", 0, 100
        )
        self._patience = declare(self, "wait_timeout", 30.0, "longest wait for subscribers [s]", 0.0, 3600.0)
        refuse_unknown_parameters(self)
        self._clock_publisher = None
        if clock == "simulated":
            profile = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
            self._clock_publisher = self.create_publisher(ClockMessage, "/clock", profile)
        else:
            scenario = replace(
                scenario, values={**scenario.values, "start_time_ns": self.get_clock().now().nanoseconds}
            )
        run = simulate(scenario, np.random.default_rng(scenario.integer("seed")))
        self._records, self._sent = list(run.records()), 0
        self._now_ns = self._due_ns = scenario.integer("start_time_ns")
        self._own_clock = (
            Clock(clock_type=ClockType.STEADY_TIME) if clock == "simulated" else self.get_clock()
        )
        kinds = {record.topic.removeprefix("/"): record.type for record in self._records}
        self._outputs = {
            f"/{topic}": self.create_publisher(
                message_class(kind), topic, offered_profile([topics.QOS[topic]], 1)
            )
            for topic, kind in kinds.items()
        }
        report_every_second(self, self._report)
        if run.fallen_at is not None:
            self.get_logger().warning(
                f"the bicycle falls {run.fallen_at:.2f} s after the start; the run ends there"
            )

    def run(self) -> None:
        """Publish the whole run, at its pace."""
        self._wait_for_subscribers()
        self.get_logger().info(f"simulating {len(self._records)} messages")
        self._before = self._own_clock.now()
        self.create_timer(TICK, self._advance, clock=Clock(clock_type=ClockType.STEADY_TIME))
        while self._sent < len(self._records):
            rclpy.spin_once(self, timeout_sec=0.1)
        for publisher in self._outputs.values():
            publisher.wait_for_all_acked(Duration(seconds=5))
        self.get_logger().info(f"published {self._sent} messages")

    def close(self) -> None:
        """Nothing is left behind."""

    def _scenario(self) -> Scenario:
        """The scenario by name, each of its keys a parameter."""
        name = declare(self, "scenario", "tms_strike", "scenario by name, or the path of a .yaml file")
        changes = {}
        for key, value in load_scenario(name).values.items():
            default = list(value) if isinstance(value, tuple) else value
            limits = (KEYS[key].low, KEYS[key].high) if isinstance(value, int | float) else (None, None)
            changes[key] = declare(self, key, default, KEYS[key].meaning, *limits)
        return load_scenario(
            name, {key: list(v) if KEYS[key].kind is tuple else v for key, v in changes.items()}
        )

    def _wait_for_subscribers(self) -> None:
        deadline = time.monotonic() + self._patience
        while lacking := [t for t, p in self._outputs.items() if p.get_subscription_count() < self._wanted]:
            if time.monotonic() > deadline:
                raise RecordingError(
                    f"expected {self._wanted} subscribers of each topic within {self._patience:g} s, found"
                    f" fewer of {', '.join(lacking)}; start them, or set wait_for_subscribers to 0"
                )
            rclpy.spin_once(self, timeout_sec=0.02)

    def _advance(self) -> None:
        """Publish what has become due since the last look."""
        now = self._own_clock.now()
        rate = self.get_parameter("rate").value if self._clock_publisher else 1.0
        self._before, elapsed = now, (now - self._before).nanoseconds
        self._due_ns += round(elapsed * rate)
        self._now_ns = min(self._due_ns, self._now_ns + LARGEST_STEP)
        if self._clock_publisher:
            stamp = Time(sec=self._now_ns // 10**9, nanosec=self._now_ns % 10**9)
            self._clock_publisher.publish(ClockMessage(clock=stamp))
        while self._sent < len(self._records) and self._records[self._sent].time_ns <= self._now_ns:
            record = self._records[self._sent]
            self._outputs[record.topic].publish(record.data)
            self._sent += 1

    def _report(self) -> Report:
        share = 100.0 * self._sent / len(self._records)
        return f"{share:.0f} % of the run published", True, {"messages": self._sent, "time_ns": self._now_ns}


def main(args: list[str] | None = None) -> int:
    """Run the simulator as a process."""
    return run_node(Simulator, args)


if __name__ == "__main__":
    sys.exit(main())
