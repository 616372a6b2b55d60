"""Running filter over live samples, restarted where a strike is found."""

from __future__ import annotations

import math
from bisect import bisect_left

from tms_model.response import FASTEST

from tms_fit.kalman.ekf import ExtendedKalmanFilter, FilterStep
from tms_fit.streaming.synchronizer import Sample
from tms_fit.strikes.strike import NANOSECONDS, Strike

HISTORY_NS = 5 * NANOSECONDS  # [ns] of samples kept: a strike is found within 3 s of its samples


class LiveFilter:
    """State of the bicycle after every sample.

    A strike is found some time after it began; the filter is then restarted from its first sample.
    """

    def __init__(self, running: ExtendedKalmanFilter, nominal_speed: float, uses_torque: bool) -> None:
        """nominal_speed [m/s]: where none was measured; uses_torque: whether a known steer torque enters."""
        self._running, self._nominal_speed, self._uses_torque = running, nominal_speed, uses_torque
        self._recent: list[Sample] = []

    def process(self, sample: Sample, strike: Strike | None) -> FilterStep | None:
        """The step after a sample and the strike found at it, if any; None without a usable speed."""
        self._recent.append(sample)
        first = len(self._recent) - 1
        if strike is not None:
            self._running.restart(strike=True)
            first = bisect_left(self._recent, strike.time_ns, key=_stamp)
        step = self._steps_from(first)
        if self._recent[0].time_ns < sample.time_ns - 2 * HISTORY_NS:
            del self._recent[: bisect_left(self._recent, sample.time_ns - HISTORY_NS, key=_stamp)]
        return step

    def _steps_from(self, first: int) -> FilterStep | None:
        """The last of the steps from a sample on."""
        step: FilterStep | None = None
        for index in range(first, len(self._recent)):
            one = self._recent[index]
            speed = one.speed if math.isfinite(one.speed) else self._nominal_speed
            if not 0.0 < speed <= FASTEST:
                return None
            step = self._running.step(
                one.time_ns, one.unsaturated, one.variance, speed, self._held_torque(index), one.speed_ns
            )
        return step

    def _held_torque(self, index: int) -> float:
        """Known torque [N m] since the sample before `index`, 0 where none is known."""
        torque = self._recent[index - 1].steer_torque if index else 0.0
        return torque if math.isfinite(torque) and self._uses_torque else 0.0


def _stamp(sample: Sample) -> int:
    return sample.time_ns
