"""Mounting, range and saturation of the gyroscopes."""

from __future__ import annotations

import math

import numpy as np
from tms_bag.samples import RunInfo
from tms_model.bicycle import Array
from tms_model.frames import flip_axes, imu_to_rear_frame, quaternion, rotation_matrix

Vector = tuple[float, float, float]
Flags = tuple[bool, bool, bool]
X, Y, Z = 8, 16, 32  # flags of tms_msgs/LeanYaw: an axis of the gyroscopes stood at its limit
FLAGS = X | Y | Z
LIMIT_SHARE = 1.0 - 1e-6  # of the range [-], from which on a reading is saturated


def orientation_of(info: RunInfo | None) -> Array:
    """Quaternion x, y, z, w of the imu in the rear frame (REP-103); the identity where none is stated."""
    if info is not None and np.isfinite(info.imu_orientation).all():
        return info.imu_orientation
    return quaternion(0.0, 0.0, 0.0)


def saturated(rates: Array, full_range: float) -> Array:
    """Signs (n, ...) of the limit that readings [rad/s] stand at, zero where they stand at none."""
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(rates) >= LIMIT_SHARE * full_range, np.sign(rates), 0.0)


class Gyroscopes:
    """Readings of one sensor in the axes of the rear frame."""

    def __init__(self, orientation: Array, full_range: float | None) -> None:
        """orientation: quaternion x, y, z, w, imu -> rear frame (REP-103).

        full_range: reading [rad/s] from which on an axis is at its limit; None: only flags mark it.
        """
        self._orientation = orientation
        self._limit = math.inf if full_range is None else LIMIT_SHARE * full_range
        turn = flip_axes(rotation_matrix(orientation).T).T
        self._rows: list[Vector] = [(row[0], row[1], row[2]) for row in turn.tolist()]
        self._enters = np.abs(turn) > 1e-12  # (3, 3) sensor's axes into those of the rear frame, by row

    def in_rear_frame(self, rates: Vector) -> Vector:
        """SAE axes of the rear frame; NaN: absent, or an absent one enters."""
        x, y, z = rates
        if not math.isfinite(x + y + z):
            turned = imu_to_rear_frame(np.array([rates]), self._orientation)[0].tolist()
            return turned[0], turned[1], turned[2]
        (a, b, c), (d, e, f), (g, h, i) = self._rows
        return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z

    def unsaturated(self, rates: Vector, flags: int) -> Vector | None:
        """The same with NaN where an axis at its limit enters, by its size or a flag; None: there is none."""
        x, y, z = rates
        limit = self._limit
        if not flags and -limit < x < limit and -limit < y < limit and -limit < z < limit:
            return None
        at_limit = [
            bool(flags & flag) or abs(rate) >= limit for rate, flag in zip(rates, (X, Y, Z), strict=True)
        ]
        if not any(at_limit):
            return None
        kept = [math.nan if one else rate for rate, one in zip(rates, at_limit, strict=True)]
        return self.in_rear_frame((kept[0], kept[1], kept[2]))

    def flagged(self, flags: int) -> Flags:
        """Axes of the rear frame that a flagged one of the sensor's enters."""
        at_limit = np.array([bool(flags & flag) for flag in (X, Y, Z)])
        x, y, z = (bool((entered & at_limit).any()) for entered in self._enters)
        return x, y, z
