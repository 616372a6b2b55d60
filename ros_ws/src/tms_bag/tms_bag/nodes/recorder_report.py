"""What a recorder says about itself once a second."""

from __future__ import annotations

from rclpy.node import Node

from tms_bag.nodes.diagnostics import Report, report_every_second
from tms_bag.nodes.discovery import Discovery
from tms_bag.nodes.stamping import Stamps
from tms_bag.writing.live_bag import LiveBag


class RecorderReport:
    """Counts and losses on /diagnostics; new losses as a warning, too."""

    def __init__(self, node: Node, bag: LiveBag, discovery: Discovery, stamps: Stamps) -> None:
        self._node, self._bag, self._discovery, self._stamps = node, bag, discovery, stamps
        self._told: dict[str, int] = {}  # losses that the user knows already
        report_every_second(node, self._make)

    def _make(self) -> Report:
        lost, writer = self._discovery.lost, self._bag.writer
        if lost != self._told:
            self._told = lost
            self._node.get_logger().warning(f"lost messages: {lost}")
        if not self._stamps.ready:
            return "waiting for /clock (use_sim_time is set)", False, {}
        counts = writer.counts
        values: dict[str, object] = {**counts, **{f"{name} lost": count for name, count in lost.items()}}
        values |= {"files": writer.file_count, "clock went back": self._stamps.jumps}
        if self._bag.recent is not None:
            values["kept in memory [bytes]"] = self._bag.recent.bytes
        doing = "paused: " if self._bag.paused else ""
        return f"{doing}{sum(counts.values())} messages in {writer.path}", not lost, values
