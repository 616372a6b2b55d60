"""Forward speed over a window as a smooth function of time.

A polynomial through the sensor's samples: their noise must not enter v', which the equations of motion need.
Where the samples don't cover the window (a camera's one figure before the strike, a topic that ends soon
after it), the bicycle is assumed to coast: from its last measurement on, the speed falls evenly by a rolling
resistance with the prior of common floors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array

MEDIAN_ERROR_RATIO = 1.2533  # standard error of a median per that of a mean, sqrt(pi / 2)
HIGHEST_DEGREE = 3  # of the polynomial
SLOPE_STANDARD_ERRORS = 5.0  # least slope of a speed that changes, per its standard error
LEAST_CHANGE_SHARE = 0.005  # of the speed, by which it must change over the window
LEAST_SAMPLES = 8  # that determine the course of the speed
UNSAMPLED_SHARE = 0.25  # of the window, at its beginning or its end, that may be without samples
# C_r, mean and standard deviation: hard wood 0.015, rubber mats 0.06 to 0.15.
ROLLING_RESISTANCE_PRIOR = (0.05, 0.05)
UNSTATED_STD_SHARE = 0.01  # standard deviation of a single speed without a stated one, per speed
LEAST_SCATTER = 1e-4  # [m/s], standard deviation of a speedometer's samples, at least
SPEED_STALE_AFTER_S = 3.0  # [s] after a measurement: whether the bicycle coasted all along is then unknown
STALE_STD_SHARE = 0.3  # standard deviation of a stale speed, per speed
FIXED, MEASURED, PRIOR, NOMINAL = "fixed", "measured", "prior", "run_info"  # sources of a speed


@dataclass(frozen=True, eq=False)
class SpeedProfile:
    """v(t) [m/s] = sum of coefficients[k] (t - origin)^k, t [s] since the first sample of the window."""

    coefficients: Array  # (k,)
    covariance: Array  # (k, k)
    measured: bool = False  # by a sensor in this run
    origin: float = 0.0  # [s]
    extrapolated: bool = False  # a straight line from the measurement at `origin`: its slope is assumed
    is_stale: bool = False  # the measurement is too old: its value at the window's start is a guess
    source: str = ""  # fixed, measured, prior or run_info; empty: not stated

    @property
    def constant(self) -> bool:
        """Whether the speed does not change."""
        return not self.coefficients[1:].any()

    @property
    def std(self) -> float:
        """Standard error [m/s] of the speed at `origin`."""
        return math.sqrt(float(self.covariance[0, 0]))

    def at(self, time: Array | float) -> Array:
        """Speed [m/s] at times [s] since the first sample."""
        since = np.asarray(time, dtype=float) - self.origin
        return np.asarray(np.polynomial.polynomial.polyval(since, self.coefficients), dtype=np.float64)


def constant_speed(speed: float, std: float = 0.0, measured: bool = False) -> SpeedProfile:
    """A speed [m/s] that does not change."""
    return SpeedProfile(np.array([speed]), np.array([[std**2]]), measured)


def fit_speed_profile(
    time: Array, speed: Array, variance: Array, model: str, last: float, coasting_loss: float
) -> SpeedProfile:
    """The curve through samples (n,) of the speed [m/s] at times [s], NaN left out; at least one is needed.

    Times count from the window's first sample, `last` is that of its last one; samples before are at most the
    one that held at the first. variance (n,) [m^2/s^2], NaN: unknown. coasting_loss [m/s^2]: what C_r = 1
    takes in a second.

    model: 'constant': the median. 'measured': the polynomial of up to third degree with the least AICc.
    'auto': the median, unless the samples show a significant change of the speed that matters. But for
    'constant', where the samples don't cover the window, the speed falls as on a common floor.
    """
    good = np.isfinite(speed)
    time, speed, variance = time[good], speed[good], variance[good]
    if model != "constant" and not _covers_window(time, last):
        used = time >= 0.0 if (time >= 0.0).any() else time == time.max()
        return _coasting_line(time[used], speed[used], variance[used], coasting_loss)
    if model != "constant":
        kept = _without_outliers(time, speed)
        curves = [_polynomial(time[kept], speed[kept], degree) for degree in range(1, HIGHEST_DEGREE + 1)]
        _, chosen = min(curves, key=lambda curve: curve[0])
        if model == "measured" or _changes(curves[0][1], float(np.ptp(time))):
            return chosen
    std = MEDIAN_ERROR_RATIO * float(np.std(speed, ddof=1)) / math.sqrt(len(speed)) if len(speed) > 1 else 0.0
    return constant_speed(float(np.median(speed)), std, measured=True)


def _covers_window(time: Array, last: float) -> bool:
    """Whether samples at these times cover a window."""
    unseen = UNSAMPLED_SHARE * last
    if len(time) < LEAST_SAMPLES or not np.ptp(time) > 0.0:
        return False
    return float(time.min()) <= unseen and float(time.max()) >= last - unseen


def _coasting_line(time: Array, speed: Array, variance: Array, coasting_loss: float) -> SpeedProfile:
    """A straight line through few samples (n,), one at least, with the slope of a common floor as prior.

    Samples determine a slope where their variance is stated or they are enough to show it: the slope is then
    the mean of theirs and the prior's, each by its variance (the two are independent about the mean time).
    """
    resistance, resistance_std = ROLLING_RESISTANCE_PRIOR
    slope, slope_variance = -resistance * coasting_loss, (resistance_std * coasting_loss) ** 2
    stated = bool((variance > 0.0).all())
    if not stated:
        if len(speed) >= LEAST_SAMPLES:
            kept = _without_outliers(time, speed)
            time, speed = time[kept], speed[kept]
        variance = np.full(len(speed), _scatter(time, speed, slope))
    weights = 1.0 / variance
    origin = float(np.average(time, weights=weights))
    since = time - origin
    precision = float(weights @ since**2)  # inverse of the variance of the samples' own slope
    if precision > 0.0 and (stated or len(speed) >= LEAST_SAMPLES):
        information = precision + 1.0 / slope_variance
        slope = (float(weights @ (since * speed)) + slope / slope_variance) / information
        slope_variance = 1.0 / information
    mean_variance = 1.0 / float(weights.sum())
    is_stale = origin < -SPEED_STALE_AFTER_S
    if is_stale:
        origin, mean_variance = 0.0, (STALE_STD_SHARE * float(speed[-1])) ** 2
    return SpeedProfile(
        np.array([float(np.average(speed, weights=weights)), slope]),
        np.diag([mean_variance, slope_variance]),
        measured=True,
        origin=origin,
        extrapolated=True,
        is_stale=is_stale,
    )


def _scatter(time: Array, speed: Array, slope: float) -> float:
    """Variance [m^2/s^2] of samples (n,) about a straight line; a guess for one sample.

    Of few samples the line has a given slope [m/s^2]: their own would follow them.
    """
    count = len(speed)
    if count == 1:
        return max((UNSTATED_STD_SHARE * float(speed[0])) ** 2, LEAST_SCATTER**2)
    if count < LEAST_SAMPLES:
        return max(float(np.var(speed - slope * time, ddof=1)), LEAST_SCATTER**2)
    matrix = np.vander(time - time.mean(), 2)
    residual = speed - matrix @ np.linalg.lstsq(matrix, speed, rcond=None)[0]
    return max(float(residual @ residual) / (count - 2), LEAST_SCATTER**2)


def _changes(line: SpeedProfile, span: float) -> bool:
    """Whether a straight line through the samples has a significant slope that matters."""
    slope, std = abs(float(line.coefficients[1])), math.sqrt(float(line.covariance[1, 1]))
    least_change = LEAST_CHANGE_SHARE * abs(float(line.coefficients[0]))
    return slope > SLOPE_STANDARD_ERRORS * std and slope * span > least_change


def _without_outliers(time: Array, speed: Array) -> NDArray[np.bool_]:
    """Which samples lie within four robust deviations of a polynomial of the highest degree."""
    matrix = np.vander(time, HIGHEST_DEGREE + 1, increasing=True)
    kept = np.ones(len(time), dtype=bool)
    for _ in range(3):
        coefficients, *_ = np.linalg.lstsq(matrix[kept], speed[kept], rcond=None)
        off = np.abs(speed - matrix @ coefficients)
        spread = 1.4826 * float(np.median(off[kept]))
        kept = off <= 4.0 * spread if spread > 0.0 else kept
    return kept


def _polynomial(time: Array, speed: Array, degree: int) -> tuple[float, SpeedProfile]:
    """AICc and curve of one degree."""
    matrix = np.vander(time, degree + 1, increasing=True)
    coefficients = np.asarray(np.linalg.lstsq(matrix, speed, rcond=None)[0], dtype=np.float64)
    count, unknowns = len(time), degree + 2
    squares = float(np.sum((speed - matrix @ coefficients) ** 2))
    variance = squares / max(count - degree - 1, 1)
    covariance = np.asarray(variance * np.linalg.inv(matrix.T @ matrix), dtype=np.float64)
    penalty = 2.0 * unknowns + 2.0 * unknowns * (unknowns + 1) / max(count - unknowns - 1, 1)
    return count * math.log(max(squares, 1e-300) / count) + penalty, SpeedProfile(
        coefficients, covariance, True
    )
