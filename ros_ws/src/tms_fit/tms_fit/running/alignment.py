"""IMU samples in the order of their stamps, each with the speed and the steer torque of its time.

What comes out depends on the samples and their stamps alone, not on the order in which they come, as long as
an IMU sample is no later than the reorder window: it waits that long for earlier ones, and until speed and
steer torque are known up to its time, or are late by more than `PATIENCE`.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from tms_bag.samples import IntArray
from tms_model.bicycle import Array

from tms_fit.strikes.strike import NANOSECONDS

Reading = tuple[int, Array, Array, Array]  # stamp, angular velocity, variance, unsaturated
PATIENCE = NANOSECONDS // 2  # [ns], how long an IMU sample waits for a speed or a torque


@dataclass(frozen=True, eq=False)
class Sample:
    """One IMU sample and what is known of its time."""

    time_ns: int
    angular_velocity: Array  # (3,) [rad/s], SAE axes of the rear frame; NaN: absent
    variance: Array  # (3,) [rad^2/s^2], NaN: unknown
    speed: float  # [m/s], NaN: unknown
    steer_torque: float  # [N m], NaN: unknown
    unsaturated: Array  # (3,) angular_velocity, NaN where an axis of the sensor at its limit enters
    speed_ns: int | None = None  # when the speed was measured; None: it was not


class Series:
    """Samples of one slow topic; of those with the same stamp the first that came."""

    def __init__(self) -> None:
        self.time: list[int] = []
        self.value: list[float] = []

    def add(self, time_ns: int, value: float) -> None:
        """One value, at its place in time."""
        index = bisect_left(self.time, time_ns)
        if index == len(self.time) or self.time[index] != time_ns:
            self.time.insert(index, time_ns)
            self.value.insert(index, value)

    def at(self, time_ns: int) -> float:
        """The last value at or before a time; NaN before the first."""
        index = bisect_right(self.time, time_ns)
        return self.value[index - 1] if index else float("nan")

    def stamp_at(self, time_ns: int) -> int | None:
        """When that value was measured; None before the first."""
        index = bisect_right(self.time, time_ns)
        return self.time[index - 1] if index else None

    def between(self, first_ns: int, last_ns: int) -> tuple[IntArray, Array]:
        """Times [ns] and values from the one that holds at `first_ns` to `last_ns`."""
        first, last = bisect_right(self.time, first_ns), bisect_right(self.time, last_ns)
        since = slice(max(first - 1, 0), last)
        return np.array(self.time[since], dtype=np.int64), np.array(self.value[since], dtype=float)

    def forget(self, before_ns: int) -> None:
        """Drop what no longer matters after a time."""
        index = bisect_right(self.time, before_ns) - 1  # keeps the one that holds at before_ns
        if index > 1000:
            del self.time[:index], self.value[:index]


class Alignment:
    """Takes samples of all topics as they arrive, gives complete ones in the order of their stamps."""

    def __init__(self, reorder_window: float, fixed_speed: float | None) -> None:
        """reorder_window [s]: longest that an IMU sample may come after a later one; fixed_speed [m/s]."""
        self.speed, self.steer_torque = Series(), Series()
        self.counts: Counter[str] = Counter()  # of IMU samples left out: repeated, late
        self._reorder_ns = round(reorder_window * NANOSECONDS)
        self._fixed_speed = fixed_speed
        self._waiting: list[Reading] = []
        self._first_ns: int | None = None
        self._given_ns: int | None = None  # stamp of the last sample given

    def add_imu(self, time_ns: int, angular_velocity: Array, variance: Array, unsaturated: Array) -> None:
        """Gyroscopes (3,) [rad/s] in SAE axes of the rear frame, variances (3,); see Sample."""
        if self._given_ns is not None and time_ns <= self._given_ns:
            self.counts["repeated" if time_ns == self._given_ns else "late"] += 1
            return
        index = bisect_left(self._waiting, time_ns, key=_stamp)
        if index < len(self._waiting) and self._waiting[index][0] == time_ns:
            self.counts["repeated"] += 1
            return
        self._first_ns = time_ns if self._first_ns is None else min(self._first_ns, time_ns)
        insort(self._waiting, (time_ns, angular_velocity, variance, unsaturated), key=_stamp)

    def ready(self, finished: bool = False) -> Iterator[Sample]:
        """The samples that are complete; all that wait if no more will come."""
        while self._waiting and (finished or self._complete(self._waiting[0][0])):
            time_ns, angular_velocity, variance, unsaturated = self._waiting.pop(0)
            self._given_ns = time_ns
            fixed = self._fixed_speed
            yield Sample(
                time_ns=time_ns,
                angular_velocity=angular_velocity,
                variance=variance,
                speed=self.speed.at(time_ns) if fixed is None else fixed,
                steer_torque=self.steer_torque.at(time_ns),
                unsaturated=unsaturated,
                speed_ns=self.speed.stamp_at(time_ns) if fixed is None else None,
            )

    def _complete(self, time_ns: int) -> bool:
        assert self._first_ns is not None
        newest = self._waiting[-1][0]
        if newest < time_ns + self._reorder_ns:
            return False
        if newest >= time_ns + PATIENCE:
            return True
        # Which topics there are shows in the first half second.
        starting = time_ns < self._first_ns + PATIENCE
        return all(
            series.time[-1] >= time_ns if series.time else not starting
            for series in (self.speed, self.steer_torque)
        )


def _stamp(sample: Reading) -> int:
    return sample[0]
