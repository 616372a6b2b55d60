"""Which time a recorded message gets: the wall's at its arrival, or the simulated time at that moment."""

from __future__ import annotations

from bisect import bisect_right

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock

from tms_bag.nodes.intake import Intake

KEPT = 10_000  # [ticks]; more than arrive while messages wait


class WallStamps:
    """The time of arrival."""

    name = "wall"
    ready = True
    jumps = 0

    def follow(self) -> None:
        """Nothing to follow."""

    def at(self, arrived_ns: int) -> int:
        """Stamp [ns] of a message that arrived at a time of the wall clock [ns]."""
        return arrived_ns


class SimulatedStamps:
    """What /clock said last when the message arrived; not ready before its first tick."""

    name = "simulated"

    def __init__(self, node: Node) -> None:
        self._intake = Intake(node, "/clock", "rosgraph_msgs/msg/Clock", KEPT)
        self._intake.adapt([QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)])
        self._arrived: list[int] = []
        self._told: list[int] = []
        self.jumps = 0  # how often the clock went back

    @property
    def ready(self) -> bool:
        """Whether the clock has ticked."""
        return bool(self._told)

    def follow(self) -> None:
        """Take the ticks that have arrived."""
        while self._intake.drain(self._tick):
            pass
        if len(self._told) > KEPT:
            del self._arrived[:-KEPT], self._told[:-KEPT]

    def at(self, arrived_ns: int) -> int:
        """Stamp [ns] of a message that arrived at a time of the wall clock [ns]."""
        return self._told[max(bisect_right(self._arrived, arrived_ns) - 1, 0)]

    def _tick(self, data: bytes, arrived_ns: int, sent_ns: int) -> None:
        clock = deserialize_message(data, Clock).clock
        time_ns = clock.sec * 10**9 + clock.nanosec
        self.jumps += bool(self._told) and time_ns < self._told[-1]
        self._arrived.append(arrived_ns)
        self._told.append(time_ns)


Stamps = WallStamps | SimulatedStamps


def make_stamps(node: Node) -> Stamps:
    """Simulated ones if the node's parameter `use_sim_time` says so."""
    return SimulatedStamps(node) if node.get_parameter("use_sim_time").value else WallStamps()
