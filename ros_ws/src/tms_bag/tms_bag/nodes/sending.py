"""The messages of a bag on their way: published, counted, and held back where nothing may be lost."""

from __future__ import annotations

from collections.abc import Callable

from tms_bag.delays import Delays
from tms_bag.nodes.handled import Window
from tms_bag.nodes.publishing import Publishers, subscription_count
from tms_bag.record import Record
from tms_bag.transport import Transport


class Sending:
    """Sends messages through publishers; with a window no more than their consumers have room for.

    `between` is called while it waits, and may raise to end the wait.
    """

    def __init__(
        self,
        publishers: Publishers,
        window: Window | None,
        transport: Transport,
        between: Callable[[], None],
    ) -> None:
        self._publishers, self._window, self._transport = publishers, window, transport
        self._between = between
        self.delays = Delays()
        self.count = 0

    def begin(self, between: Callable[[], None]) -> None:
        """Wait for the consumers, if there is a window. RecordingError if they don't come."""
        if self._window:
            self._window.begin(self._publishers.values(), between)

    def send(self, record: Record, late: float | None) -> None:
        """Publish a message that is so late [s]; None: it belongs to no time, and isn't late."""
        publisher = self._publishers[record.topic]
        if self._window:
            self._window.wait_for_room(publisher.topic_name, self._between)
            self._window.count(publisher.topic_name)
            self._transport.stand_at(record.time_ns)
        publisher.publish(record.data)
        self.count += 1
        if late is not None:
            self.delays.add(late)

    def finish(self) -> None:
        """Wait until everything has been handled, if there is a window."""
        if self._window:
            self._window.wait_for_all(self._between)

    def figures(self) -> dict[str, object]:
        """What is of interest while it goes on, by name."""
        return {
            "messages": self.count,
            "subscriptions": subscription_count(self._publishers),
            "rate": self._transport.rate,
            **self.delays.figures(),
        }
