"""The forward speed over a window as a smooth function of time, from what a speed sensor said.

A polynomial: the sensor's noise would make nonsense of v', which enters the equations of motion. Where the
sensor didn't say how the speed goes on over the window (a camera's one figure before the strike, a topic that
ends soon after it), the bicycle is taken to coast: the speed falls evenly from when it was measured on, by a
rolling resistance that is known as that of floors is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array

MEDIAN = 1.2533  # standard error of a median per that of a mean, sqrt(pi / 2)
HIGHEST = 3  # degree of the polynomial
CERTAIN = 5.0  # standard errors that a slope must have before the speed is said to change
MATTERS = 0.005  # share of the speed that it must change by over the window
ENOUGH = 8  # samples that tell how the speed goes
UNSEEN = 0.25  # share of the window, at its beginning or its end, that may be without samples
FLOORS = (0.05, 0.05)  # C_r and its standard deviation: hard wood 0.015, rubber mats 0.06 to 0.15
UNSTATED = 0.01  # share of a single speed that is its standard deviation where nobody states one
FINEST = 1e-4  # [m/s], scatter of a speedometer's samples that none is below
FORGOTTEN = 3.0  # [s] since a measurement, after which nobody knows whether the bicycle coasted all along:
GUESSED = 0.3  # it is then a guess, with this share of it for standard deviation


@dataclass(frozen=True, eq=False)
class SpeedProfile:
    """v(t) [m/s] = sum of coefficients[k] (t - origin)^k, t [s] since the first sample of the window."""

    coefficients: Array  # (k,)
    covariance: Array  # (k, k)
    measured: bool = False  # by a sensor in this run
    origin: float = 0.0  # [s]
    extrapolated: bool = False  # a straight line from what was measured at `origin`: how it falls is assumed
    forgotten: bool = (
        False  # what was measured is too long ago: at the window's start it is no more than a guess
    )

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
    'auto': the median, unless the samples show beyond doubt that the speed changes enough to matter. But for
    'constant', where the samples don't tell how the speed goes over the window, it falls as on some floor.
    """
    good = np.isfinite(speed)
    time, speed, variance = time[good], speed[good], variance[good]
    if model != "constant" and not _told(time, last):
        used = time >= 0.0 if (time >= 0.0).any() else time == time.max()
        return _falling(time[used], speed[used], variance[used], coasting_loss)
    if model != "constant":
        kept = _without_outliers(time, speed)
        curves = [_polynomial(time[kept], speed[kept], degree) for degree in range(1, HIGHEST + 1)]
        _, chosen = min(curves, key=lambda curve: curve[0])
        if model == "measured" or _changes(curves[0][1], float(np.ptp(time))):
            return chosen
    std = MEDIAN * float(np.std(speed, ddof=1)) / math.sqrt(len(speed)) if len(speed) > 1 else 0.0
    return constant_speed(float(np.median(speed)), std, measured=True)


def _told(time: Array, last: float) -> bool:
    """Whether samples at some times tell how the speed goes over a window."""
    unseen = UNSEEN * last
    if len(time) < ENOUGH or not np.ptp(time) > 0.0:
        return False
    return float(time.min()) <= unseen and float(time.max()) >= last - unseen


def _falling(time: Array, speed: Array, variance: Array, coasting_loss: float) -> SpeedProfile:
    """A straight line through few samples (n,), one at least, that falls as on some floor if they don't tell.

    They tell where they state their variance or are enough for their scatter to tell it: then the slope is
    the mean of theirs and the floor's, each by its variance (the two are independent about the mean time).
    """
    slope, slope_variance = -FLOORS[0] * coasting_loss, (FLOORS[1] * coasting_loss) ** 2
    stated = bool((variance > 0.0).all())
    if not stated:
        kept = _without_outliers(time, speed) if len(speed) >= ENOUGH else np.ones(len(speed), dtype=bool)
        time, speed = time[kept], speed[kept]
        variance = np.full(len(speed), _scatter(time, speed, slope))
    weights = 1.0 / variance
    origin = float(np.average(time, weights=weights))
    since = time - origin
    told = float(weights @ since**2)  # inverse of the variance of the samples' own slope
    if told > 0.0 and (stated or len(speed) >= ENOUGH):
        information = told + 1.0 / slope_variance
        slope = (float(weights @ (since * speed)) + slope / slope_variance) / information
        slope_variance = 1.0 / information
    mean_variance = 1.0 / float(weights.sum())
    forgotten = origin < -FORGOTTEN
    if forgotten:
        origin, mean_variance = 0.0, (GUESSED * float(speed[-1])) ** 2
    return SpeedProfile(
        np.array([float(np.average(speed, weights=weights)), slope]),
        np.diag([mean_variance, slope_variance]),
        measured=True,
        origin=origin,
        extrapolated=True,
        forgotten=forgotten,
    )


def _scatter(time: Array, speed: Array, slope: float) -> float:
    """Variance [m^2/s^2] of samples (n,) about a straight line; a guess for one sample.

    Of few samples the line has a given slope [m/s^2]: their own would follow them.
    """
    count = len(speed)
    if count == 1:
        return max((UNSTATED * float(speed[0])) ** 2, FINEST**2)
    if count < ENOUGH:
        return max(float(np.var(speed - slope * time, ddof=1)), FINEST**2)
    matrix = np.vander(time - time.mean(), 2)
    residual = speed - matrix @ np.linalg.lstsq(matrix, speed, rcond=None)[0]
    return max(float(residual @ residual) / (count - 2), FINEST**2)


def _changes(line: SpeedProfile, span: float) -> bool:
    """Whether a straight line through the samples says that the speed changes."""
    slope, std = abs(float(line.coefficients[1])), math.sqrt(float(line.covariance[1, 1]))
    return slope > CERTAIN * std and slope * span > MATTERS * abs(float(line.coefficients[0]))


def _without_outliers(time: Array, speed: Array) -> NDArray[np.bool_]:
    """Which samples lie within four robust deviations of a polynomial of the highest degree."""
    matrix = np.vander(time, HIGHEST + 1, increasing=True)
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
