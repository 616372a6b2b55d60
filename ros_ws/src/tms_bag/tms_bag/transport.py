"""Where a player stands in its bag: playing at a rate, paused, stepping, told to go elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Condition


class StoppedError(Exception):
    """Playing was to end: raised in whoever waits for something else."""


class Transport:
    """The bag's time as a function of real time; methods may be called from several threads."""

    def __init__(self, start_ns: int, rate: float, paused: bool = False) -> None:
        self._changed = Condition()
        self._bag_ns, self._anchor = start_ns, time.monotonic()
        self._rate, self._paused = rate, paused
        self._steps = 0  # messages to publish while paused
        self._target: int | None = None  # where to go on [ns]
        self._stopped = False

    @property
    def rate(self) -> float:
        """Times real time."""
        return self._rate

    @property
    def paused(self) -> bool:
        """Whether the bag's time stands still."""
        return self._paused

    @property
    def stopped(self) -> bool:
        """Whether playing has been ended."""
        return self._stopped

    def now_ns(self) -> int:
        """The bag's time at this moment [ns]."""
        with self._changed:
            return self._now()

    def set_rate(self, rate: float) -> None:
        """Go on at another rate from now on."""
        with self._changed:
            self._settle(self._now())
            self._rate = rate

    def pause(self, paused: bool = True) -> None:
        """Let the bag's time stand still, or go on."""
        with self._changed:
            self._settle(self._now())
            self._paused = paused
            self._steps = 0

    def step(self) -> bool:
        """Let one message pass; only while paused."""
        with self._changed:
            self._steps += self._paused
            self._changed.notify_all()
            return self._paused

    def begin(self, bag_ns: int) -> None:
        """Start to play at a time of the bag [ns], or where `seek` said; steps asked for before count."""
        with self._changed:
            self._target = bag_ns if self._target is None else self._target
            self._settle(self._target)

    def seek(self, bag_ns: int) -> None:
        """Go on from another time of the bag [ns]."""
        with self._changed:
            self._settle(bag_ns)
            self._target = bag_ns
            self._steps = 0

    def stop(self) -> None:
        """End it: nothing more is to be played."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def stand_at(self, bag_ns: int) -> None:
        """Let it be this time of the bag [ns] now: what was waited for something else doesn't count."""
        with self._changed:
            self._settle(bag_ns)

    def take_target(self) -> int | None:
        """Where `seek` said to go on [ns], once."""
        with self._changed:
            target, self._target = self._target, None
            return target

    def wait_until(self, bag_ns: int, longest_step: float, between: Callable[[], None]) -> float | None:
        """Wait for a time of the bag [ns], calling `between` at least every `longest_step` [s] of real time.

        Returns how late it is [s], or None if `seek` was called: what one waited for is not to be played.
        """
        while True:
            between()
            with self._changed:
                if self._target is not None:
                    return None
                if self._steps:
                    self._steps -= 1
                    self._settle(bag_ns)
                    return 0.0
                left = (bag_ns - self._now()) / 1e9 / self._rate
                if not self._paused and left <= 0.0:
                    return -left
                self._changed.wait(longest_step if self._paused else min(left, longest_step))

    def _now(self) -> int:
        if self._paused:
            return self._bag_ns
        return self._bag_ns + round((time.monotonic() - self._anchor) * self._rate * 1e9)

    def _settle(self, bag_ns: int) -> None:
        self._bag_ns, self._anchor = bag_ns, time.monotonic()
        self._changed.notify_all()
