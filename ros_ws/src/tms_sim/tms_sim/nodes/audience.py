"""Those who are to hear a run from its first message on."""

from __future__ import annotations

import time
from collections.abc import Collection
from typing import Any

import rclpy
from rclpy.node import Node
from tms_bag import RecordingError
from tms_bag.nodes.consumers import Consumers
from tms_bag.nodes.listeners import wait_until_known

from tms_sim.nodes.settings import Settings

LOOK = 0.02  # [s]


class Audience:
    """Subscribers of each topic, and consumers that say what they want to hear."""

    def __init__(self, node: Node, settings: Settings) -> None:
        self._node = node
        self._wanted, self._patience = settings.wait_for_subscribers, settings.wait_timeout
        self._consumers = Consumers(node, settings.handled_topics)

    def wait(self, publishers: Collection[Any]) -> None:
        """Return when all are there, and know the publishers. RecordingError when they aren't in time."""
        deadline = time.monotonic() + self._patience
        while lacking := self._lacking(publishers):
            if time.monotonic() > deadline:
                raise RecordingError(
                    f"expected {self._words()} within {self._patience:g} s, found too few:"
                    f" {', '.join(lacking)}; start them, or ask for less by wait_for_subscribers and"
                    " handled_topics"
                )
            self._look()
        if self._wanted or self._consumers.topics:
            wait_until_known(self._node, [publisher.topic_name for publisher in publishers], self._look)

    def _look(self) -> None:
        rclpy.spin_once(self._node, timeout_sec=LOOK)

    def _lacking(self, publishers: Collection[Any]) -> list[str]:
        few = [p.topic_name for p in publishers if p.get_subscription_count() < self._wanted]
        return few + self._consumers.lacking(publishers)

    def _words(self) -> str:
        words = f"{self._wanted} subscribers of each topic"
        return words + (
            f" and who reports on {', '.join(self._consumers.topics)}" if self._consumers.topics else ""
        )
