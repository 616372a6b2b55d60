"""Synchronisation of IMU, speed and steer-torque samples by their stamps.

The output depends on the samples and their stamps alone, not on the order of their arrival, as long as no IMU
sample is later than the reorder window: each waits that long for earlier ones, and until speed and steer
torque are known up to its time, or are late by more than `LONGEST_WAIT_NS`.
Readings that are not finite or beyond the limits of `tms_bag.reading_limits` are left out here.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from tms_bag.reading_limits import (
    SPEED_LIMIT,
    TORQUE_LIMIT,
    measured_rates,
    stated_variance,
)
from tms_bag.samples import IntArray
from tms_model.bicycle import Array

from tms_fit.gyroscopes import FLAGS, Flags, Gyroscopes, Vector
from tms_fit.strikes.strike import NANOSECONDS

Reading = tuple[int, Vector, Vector]  # stamp, angular velocity in imu axes, variance
WAITING_FLAGS_LIMIT = 1000  # flags that wait for their IMU sample
NOT_FLAGGED: Flags = (False, False, False)
LONGEST_WAIT_NS = NANOSECONDS // 2  # [ns] that an IMU sample waits for a speed or a torque


@dataclass(frozen=True, eq=False, slots=True)
class Sample:
    """One IMU sample with the speed and the steer torque of its time."""

    time_ns: int
    angular_velocity: Vector  # [rad/s], SAE axes of the rear frame; NaN: absent
    variance: Vector  # [rad^2/s^2], NaN: unknown
    speed: float  # [m/s], NaN: unknown
    steer_torque: float  # [N m], NaN: unknown
    unsaturated: Vector  # angular_velocity, NaN where an axis of the sensor at its limit enters
    speed_ns: int | None = None  # when the speed was measured; None: it was not
    flagged: Flags = NOT_FLAGGED  # axes of angular_velocity that an axis marked as saturated enters


class Series:
    """Samples of one slow topic; of those with the same stamp the first one, or the one with a variance."""

    def __init__(self, limit: float = math.inf) -> None:
        """limit: magnitude of a value, in its unit, from which on it is no reading."""
        self._limit = limit
        self.time: list[int] = []
        self.value: list[float] = []
        self.variance: list[float] = []  # NaN: unknown

    def add(self, time_ns: int, value: float, variance: float = math.nan) -> None:
        """One value, at its place in time; left out unless it is finite and within the limit."""
        if not -self._limit < value < self._limit:
            return
        variance = stated_variance(variance)
        index = len(self.time)
        if index and time_ns <= self.time[-1]:
            index = bisect_left(self.time, time_ns)
            if self.time[index] == time_ns:
                if math.isnan(self.variance[index]) and not math.isnan(variance):
                    self.value[index], self.variance[index] = value, variance
                return
        self.time.insert(index, time_ns)
        self.value.insert(index, value)
        self.variance.insert(index, variance)

    def at(self, time_ns: int) -> tuple[float, int | None]:
        """The last value at or before a time, and when it was measured; NaN and None before the first."""
        index = bisect_right(self.time, time_ns)
        return (self.value[index - 1], self.time[index - 1]) if index else (math.nan, None)

    def between(self, first_ns: int, last_ns: int) -> tuple[IntArray, Array, Array]:
        """Times [ns], values and variances from the one that holds at `first_ns` to `last_ns`."""
        first, last = bisect_right(self.time, first_ns), bisect_right(self.time, last_ns)
        since = slice(max(first - 1, 0), last)
        return (
            np.array(self.time[since], dtype=np.int64),
            np.array(self.value[since], dtype=float),
            np.array(self.variance[since], dtype=float),
        )

    def discard(self, before_ns: int) -> None:
        """Discard values that hold before a time only."""
        index = bisect_right(self.time, before_ns) - 1  # keeps the one that holds at before_ns
        if index > 1000:
            del self.time[:index], self.value[:index], self.variance[:index]


class SampleSynchronizer:
    """Samples of all topics in, complete samples out in the order of their stamps."""

    def __init__(
        self, gyroscopes: Gyroscopes, reorder_window: float, fixed_speed: float | None = None
    ) -> None:
        """reorder_window [s]: longest that an IMU sample may come after a later one; fixed_speed [m/s]."""
        self.speed, self.steer_torque = Series(SPEED_LIMIT), Series(TORQUE_LIMIT)
        self.counts: Counter[str] = (
            Counter()
        )  # IMU samples left out: repeated, late; saturated, missing an axis
        self._gyroscopes = gyroscopes
        self._reorder_ns = round(reorder_window * NANOSECONDS)
        self._fixed_speed = fixed_speed
        self._waiting: list[Reading] = []
        self._flags: dict[int, int] = {}  # by stamp, of samples that are still to be released
        self._first_ns: int | None = None
        self._released_ns: int | None = None  # stamp of the last sample released
        self._present: Flags = NOT_FLAGGED  # axes of the sensor that were measured in an earlier sample

    def add_imu(self, time_ns: int, angular_velocity: Vector, variance: Vector) -> None:
        """Gyroscopes [rad/s] in imu axes and their variances; see Sample."""
        if self._released_ns is not None and time_ns <= self._released_ns:
            self.counts["repeated" if time_ns == self._released_ns else "late"] += 1
            return
        reading, waiting = (time_ns, angular_velocity, variance), self._waiting
        if not waiting or time_ns > waiting[-1][0]:
            waiting.append(reading)
        else:
            index = bisect_left(waiting, time_ns, key=_stamp)
            if waiting[index][0] == time_ns:
                self.counts["repeated"] += 1
                return
            waiting.insert(index, reading)
        if self._first_ns is None or time_ns < self._first_ns:
            self._first_ns = time_ns

    def add_flags(self, time_ns: int, flags: int) -> None:
        """Axes of the gyroscopes at their limit in the IMU sample of this stamp, flags of tms_msgs/LeanYaw.

        Flags of a sample that has been released are late: counted, without effect.
        """
        flags &= FLAGS
        if not flags:
            return
        if self._released_ns is not None and time_ns <= self._released_ns:
            self.counts["late_flags"] += 1
            return
        if len(self._flags) >= WAITING_FLAGS_LIMIT:  # of samples that never came
            self.counts["late_flags"] += 1
            del self._flags[min(self._flags)]
        self._flags[time_ns] = self._flags.get(time_ns, 0) | flags

    def ready(self, finished: bool = False) -> Iterator[Sample]:
        """Complete samples, in time order; all that wait if the input has ended."""
        while self._waiting and (finished or self._complete(self._waiting[0][0])):
            yield self._release(*self._waiting.pop(0))

    def discard(self, before_ns: int) -> None:
        """Discard speeds and torques that hold before a time only."""
        self.speed.discard(before_ns)
        self.steer_torque.discard(before_ns)

    def _release(self, time_ns: int, rates: Vector, variance: Vector) -> Sample:
        """A reading with the speed and the torque of its time."""
        self._released_ns = time_ns
        flags = self._flags.pop(time_ns, 0) if self._flags else 0
        rates = measured_rates(rates)
        self._count_missing(rates)
        turned = self._gyroscopes.in_rear_frame(rates)
        unsaturated = self._gyroscopes.unsaturated(rates, flags)
        if unsaturated is not None:
            self.counts["saturated"] += 1
        speed, speed_ns = self._fixed_speed, None
        if speed is None:
            speed, speed_ns = self.speed.at(time_ns)
        return Sample(
            time_ns=time_ns,
            angular_velocity=turned,
            variance=(
                stated_variance(variance[0]),
                stated_variance(variance[1]),
                stated_variance(variance[2]),
            ),
            speed=speed,
            steer_torque=self.steer_torque.at(time_ns)[0],
            unsaturated=turned if unsaturated is None else unsaturated,
            speed_ns=speed_ns,
            flagged=self._gyroscopes.flagged(flags) if flags else NOT_FLAGGED,
        )

    def _count_missing(self, rates: Vector) -> None:
        """Count a sample without an axis that an earlier one had; a sensor may lack an axis altogether."""
        x, y, z = rates
        there = not math.isnan(x), not math.isnan(y), not math.isnan(z)
        if there != self._present:
            a, b, c = self._present
            self.counts["missing"] += (a and not there[0]) or (b and not there[1]) or (c and not there[2])
            self._present = a or there[0], b or there[1], c or there[2]

    def _complete(self, time_ns: int) -> bool:
        assert self._first_ns is not None
        newest = self._waiting[-1][0]
        if newest < time_ns + self._reorder_ns:
            return False
        if newest >= time_ns + LONGEST_WAIT_NS:
            return True
        # Which topics there are shows in the first half second.
        starting = time_ns < self._first_ns + LONGEST_WAIT_NS
        speed, torque = self.speed.time, self.steer_torque.time
        return (speed[-1] >= time_ns if speed else not starting) and (
            torque[-1] >= time_ns if torque else not starting
        )


def _stamp(sample: Reading) -> int:
    return sample[0]
