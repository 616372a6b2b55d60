"""When the next message of a bag is due."""

from __future__ import annotations

import time
from collections.abc import Callable


class Pacing:
    """Turns the bag's time into waiting, at a rate that may change on the way."""

    def __init__(self, start_ns: int, rate: float) -> None:
        self._start_ns = start_ns
        self._bag_ns, self._anchor = start_ns, time.monotonic()
        self._rate = rate
        self._next_step = self._anchor  # when `between` is due
        self.largest_delay = 0.0  # [s] how late a message has been at most

    def set_rate(self, rate: float) -> None:
        """Go on at another rate from now on."""
        if rate != self._rate:
            self._bag_ns, self._anchor = self.now_ns(), time.monotonic()
            self._rate = rate

    def now_ns(self) -> int:
        """The bag's time at this moment [ns]."""
        return self._bag_ns + round((time.monotonic() - self._anchor) * self._rate * 1e9)

    def wait_until(self, bag_ns: int, longest_step: float, between: Callable[[], None]) -> None:
        """Sleep until a time of the bag [ns], calling `between` every `longest_step` [s] of real time."""
        while True:
            now = time.monotonic()
            if now >= self._next_step:
                self._next_step = now + longest_step
                between()
            left = (bag_ns - self.now_ns()) / 1e9 / self._rate
            if left <= 0.0:
                break
            time.sleep(min(left, longest_step))
        if bag_ns >= self._start_ns:  # latched messages from before the start are not late
            self.largest_delay = max(self.largest_delay, -left)
