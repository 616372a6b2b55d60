"""The forward speed over a window as a smooth function of time, from what a speed sensor said.

A polynomial: the sensor's noise would make nonsense of v', which enters the equations of motion.
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


@dataclass(frozen=True, eq=False)
class SpeedCurve:
    """v(t) [m/s] = sum of coefficients[k] t^k, t [s] since the first sample of the window."""

    coefficients: Array  # (k,)
    covariance: Array  # (k, k)
    measured: bool = False  # by a sensor in this run

    @property
    def constant(self) -> bool:
        """Whether the speed does not change."""
        return not self.coefficients[1:].any()

    @property
    def std(self) -> float:
        """Standard error [m/s] of the speed at the first sample."""
        return math.sqrt(float(self.covariance[0, 0]))

    def at(self, time: Array | float) -> Array:
        """Speed [m/s] at times [s] since the first sample."""
        return np.polynomial.polynomial.polyval(np.asarray(time, dtype=float), self.coefficients)


def constant_speed(speed: float, std: float = 0.0, measured: bool = False) -> SpeedCurve:
    """A speed [m/s] that does not change."""
    return SpeedCurve(np.array([speed]), np.array([[std**2]]), measured)


def speed_curve(time: Array, speed: Array, model: str) -> SpeedCurve:
    """The curve through samples (n,) of the speed [m/s] at times [s], NaN left out; at least one is needed.

    model: 'constant': the median. 'measured': the polynomial of up to third degree with the least AICc.
    'auto': the median, unless the samples show beyond doubt that the speed changes enough to matter.
    """
    good = np.isfinite(speed)
    time, speed = time[good], speed[good]
    if model != "constant" and len(speed) >= 8 and np.ptp(time) > 0.0:
        kept = _without_outliers(time, speed)
        curves = [_polynomial(time[kept], speed[kept], degree) for degree in range(1, HIGHEST + 1)]
        _, chosen = min(curves, key=lambda curve: curve[0])
        if model == "measured" or _changes(curves[0][1], float(np.ptp(time))):
            return chosen
    std = MEDIAN * float(np.std(speed, ddof=1)) / math.sqrt(len(speed)) if len(speed) > 1 else 0.0
    return constant_speed(float(np.median(speed)), std, measured=True)


def _changes(line: SpeedCurve, span: float) -> bool:
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


def _polynomial(time: Array, speed: Array, degree: int) -> tuple[float, SpeedCurve]:
    """AICc and curve of one degree."""
    matrix = np.vander(time, degree + 1, increasing=True)
    coefficients = np.asarray(np.linalg.lstsq(matrix, speed, rcond=None)[0], dtype=np.float64)
    count, unknowns = len(time), degree + 2
    squares = float(np.sum((speed - matrix @ coefficients) ** 2))
    variance = squares / max(count - degree - 1, 1)
    covariance = np.asarray(variance * np.linalg.inv(matrix.T @ matrix), dtype=np.float64)
    penalty = 2.0 * unknowns + 2.0 * unknowns * (unknowns + 1) / max(count - unknowns - 1, 1)
    return count * math.log(max(squares, 1e-300) / count) + penalty, SpeedCurve(
        coefficients, covariance, True
    )
