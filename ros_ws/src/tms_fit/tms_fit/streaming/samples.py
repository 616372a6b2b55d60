"""Synchronised samples as growing arrays."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from tms_bag.samples import IntArray
from tms_model.bicycle import Array

from tms_fit.gyroscopes import Flags, Vector
from tms_fit.segment import Segment
from tms_fit.streaming.synchronizer import Sample, Series

_ROW = np.dtype(
    [
        ("time_ns", np.int64),
        ("angular_velocity", np.float64, 3),  # [rad/s], SAE axes of the rear frame
        ("steer_torque", np.float64),  # [N m], NaN: unknown
        ("flagged", np.bool_, 3),  # axes that an axis marked as saturated enters
    ]
)
FIRST_CAPACITY = 1024  # rows


class Samples:
    """Samples in ascending time, and the speeds measured beside them."""

    def __init__(self, speed: Series, nominal_speed: float) -> None:
        """speed: all speeds up to the newest sample; nominal_speed [m/s]: where there are none, or NaN."""
        self.speed, self.nominal_speed = speed, nominal_speed
        self._array, self._count = np.empty(FIRST_CAPACITY, _ROW), 0
        self._added: list[tuple[int, Vector, float, Flags]] = []  # rows that are not in the array yet

    @property
    def time_ns(self) -> IntArray:
        """Stamps (n,) [ns]."""
        return self._rows()["time_ns"]

    @property
    def angular_velocity(self) -> Array:
        """Angular velocity (n, 3) [rad/s], SAE axes of the rear frame; NaN: absent."""
        return self._rows()["angular_velocity"]

    def append(self, sample: Sample) -> None:
        """Add one sample, later than all before."""
        self._added.append((sample.time_ns, sample.angular_velocity, sample.steer_torque, sample.flagged))
        if len(self._added) >= FIRST_CAPACITY:
            self._rows()

    def extend(self, samples: Iterable[Sample]) -> None:
        """Add samples in ascending time."""
        for sample in samples:
            self.append(sample)

    def segment(self, first_ns: int, last_ns: int) -> Segment:
        """Copy of the samples between two times [ns], both included; at least one is needed."""
        rows = self._rows()
        times = rows["time_ns"]
        rows = rows[bisect_left(times, first_ns) : bisect_right(times, last_ns)]
        first, last = rows["time_ns"][[0, -1]].tolist()
        speed_time_ns, speeds, variances = self.speed.between(first, last)
        return Segment(
            rows["time_ns"].copy(),
            rows["angular_velocity"].copy(),
            rows["steer_torque"].copy(),
            speed_time_ns,
            speeds,
            variances,
            self.nominal_speed,
            rows["flagged"].copy() if rows["flagged"].any() else None,
        )

    def clear(self) -> None:
        """Discard everything."""
        self._array, self._count, self._added, self.speed = np.empty(0, _ROW), 0, [], Series()

    def discard(self, before_ns: int) -> None:
        """Discard samples before a time [ns]; segments made of them stay as they are."""
        rows = self._rows()
        self._array = rows[bisect_left(rows["time_ns"], before_ns) :].copy()
        self._count = len(self._array)

    def _rows(self) -> NDArray[np.void]:
        """All samples; those added since the last call are moved into the array."""
        if self._added:
            end = self._count + len(self._added)
            if end > len(self._array):
                room = np.empty(max(end, FIRST_CAPACITY), _ROW)
                self._array = np.concatenate([self._array[: self._count], room])
            self._array[self._count : end] = self._added
            self._count, self._added = end, []
        return self._array[: self._count]
