"""What nodes say about themselves once a second, on /diagnostics."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

# Summary, whether all is well, and further figures by name.
Report = tuple[str, bool, Mapping[str, object]]


def report_every_second(node: Node, report: Callable[[], Report]) -> None:
    """Publish what `report` says as a DiagnosticArray at 1 Hz."""
    publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)

    def publish() -> None:
        message, well, values = report()
        status = DiagnosticStatus(
            level=DiagnosticStatus.OK if well else DiagnosticStatus.WARN,
            name=node.get_fully_qualified_name(),
            message=message,
            hardware_id=node.get_name(),
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(array)

    # Real time: the simulated one may stand still, and then one wants to know what a node is waiting for.
    node.create_timer(1.0, publish, clock=Clock(clock_type=ClockType.STEADY_TIME))
