"""Magnitudes beyond which a number is no reading of a bicycle's sensors, and recordings without such numbers.

A reading that is not finite, or beyond its limit, counts as missing: NaN for one axis of a gyroscope and for
a variance; a speed or a torque as if its message had not come. Live and recorded samples pass the same limits
in `tms_fit.streaming.synchronizer`.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tms_bag.recording import Recording
from tms_bag.samples import FloatArray, selected

# [rad/s], 57,000 deg/s: gyroscopes for projectiles reach 50,000 deg/s, those of IMUs 4,000.
RATE_LIMIT = 1e3
SPEED_LIMIT = 1e3  # [m/s]; no bicycle's, and more than any wheel or GPS sensor reads
TORQUE_LIMIT = 1e4  # [N m]; arms reach 100
VARIANCE_LIMIT = 1e6  # [rad^2/s^2] and [m^2/s^2], the squares of the first two
LEAST_VARIANCE = 1e-24  # the same units; a smaller one, as the 0 of REP-145, states nothing


def measured(values: FloatArray, limit: float) -> FloatArray:
    """Readings of any shape with NaN where one is not finite or beyond a limit in the same unit."""
    return np.where(np.abs(values) < limit, values, np.nan)


def measured_rates(rates: tuple[float, float, float]) -> tuple[float, float, float]:
    """Gyroscope readings [rad/s] with NaN where one is not finite or beyond `RATE_LIMIT`."""
    x, y, z = rates
    low, high = -RATE_LIMIT, RATE_LIMIT
    if low < x < high and low < y < high and low < z < high:
        return rates
    return (
        x if low < x < high else math.nan,
        y if low < y < high else math.nan,
        z if low < z < high else math.nan,
    )


def stated_variance(variance: float) -> float:
    """A variance, NaN where it is unknown: not between `LEAST_VARIANCE` and `VARIANCE_LIMIT`."""
    return variance if LEAST_VARIANCE < variance < VARIANCE_LIMIT else math.nan


def without_impossible(recording: Recording) -> Recording:
    """The recording without impossible readings, NaN in their place, and a warning for each stream with some.

    Torques are left out instead: each holds until the next one.
    """
    imu, speed, torque = recording.imu, recording.speed, recording.steer_torque
    rates = measured(imu.angular_velocity, RATE_LIMIT)
    there = np.isfinite(rates)
    lacking = ~there & there.any(axis=0)  # an axis that is never measured is absent, not missing
    warnings = _warning(lacking, "gyroscope samples", f"{RATE_LIMIT:g} rad/s")
    variance = np.array([stated_variance(one) for one in imu.angular_velocity_variance.tolist()])
    imu = replace(imu, angular_velocity=rates, angular_velocity_variance=variance)
    if speed is not None:
        values = measured(speed.speed, SPEED_LIMIT)
        warnings += _warning(np.isnan(values), "speeds", f"{SPEED_LIMIT:g} m/s")
        speed = replace(speed, speed=values)
    if torque is not None:
        values = measured(torque.steer_torque, TORQUE_LIMIT)
        warnings += _warning(np.isnan(values), "steer torques", f"{TORQUE_LIMIT:g} N m")
        torque = replace(torque, steer_torque=values)
        if not np.isnan(values).all():
            torque = selected(torque, ~np.isnan(values))
    return replace(
        recording, imu=imu, speed=speed, steer_torque=torque, warnings=(*recording.warnings, *warnings)
    )


def _warning(missing: NDArray[np.bool_], what: str, limit: str) -> tuple[str, ...]:
    """One line where a stream lacks readings; missing: (n,), or (n, k) with k axes."""
    rows = missing.reshape(len(missing), -1 if missing.size else 1)
    count, total = int(np.count_nonzero(rows.any(axis=1))), len(rows)
    if not count:
        return ()
    verb, ending = ("is", "counts") if count == 1 else ("are", "count")
    return (f"{count} of {total} {what} {verb} not finite or beyond {limit}, and {ending} as missing",)
