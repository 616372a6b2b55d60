"""Messages that were sent and did not arrive, told from the sequence numbers of their publisher."""

from __future__ import annotations

from collections.abc import Callable, Collection


class SequenceCounter:
    """Counts what is missing between the messages of a topic.

    A publisher numbers its messages 1, 2, 3, ... . Numbers of several publishers can't be told apart here,
    since rclpy doesn't say who sent a message: while there are several, nothing is counted.
    """

    def __init__(self, publishers: Callable[[], Collection[object]]) -> None:
        self._publishers = publishers
        self._known = frozenset(publishers())
        self._last = 0  # 0: the next message may have any number
        self.missing = 0  # messages
        self.missed_before: int | None = None  # messages sent before the first that arrived; None: none came

    def refresh(self) -> None:
        """Notice publishers that have come or gone."""
        known = frozenset(self._publishers())
        if known != self._known:
            self._known, self._last = known, 0

    def follow(self, sequence: int) -> None:
        """Take the number of a message that has arrived."""
        if sequence != self._last + 1:
            self.refresh()  # seldom, so that it may take its time
            if 0 < self._last < sequence and len(self._known) <= 1:
                self.missing += sequence - self._last - 1
        if self.missed_before is None:
            self.missed_before = sequence - 1 if len(self._known) <= 1 else 0
        self._last = sequence
