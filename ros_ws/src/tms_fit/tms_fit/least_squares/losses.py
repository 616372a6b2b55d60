"""Robust losses: weights of residuals, and covariance of M-estimators.

A loss is given by psi, the derivative of the cost of a standardised residual u: psi(u) / u is the weight in
iteratively reweighted least squares. The covariance is that of an M-estimator,

    k^2 mean(psi^2) / mean(psi')^2 (X'X)^-1,   k = 1 + p/n (1 - m)/m, m = mean(psi')

Reference: P. J. Huber, Robust Statistics (1981), section 7.6, doi 10.1002/0471725250.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tms_model.bicycle import Array

HUBER_K = 1.345  # standard deviations, above which the weight falls: 95 % efficiency on Gaussian noise
STUDENT_T_DEGREES = 4.0  # of freedom
HAMPEL_MEDIAN = 0.685  # median of |u - median of five|, where not zero, for Gaussian white noise
MIN_SAMPLES = 20  # of a channel, for the detection of outliers
NORMAL_MAD = 0.6744897501960817  # median of |u| for Gaussian noise of unit standard deviation


@dataclass(frozen=True)
class Loss:
    """Robust loss by its name."""

    name: str  # of LOSSES

    def psi(self, u: Array) -> Array:
        """Derivative (m,) of the cost by standardised residuals (m,)."""
        if self.name == "huber":
            return np.clip(u, -HUBER_K, HUBER_K)
        if self.name == "student_t":
            return (STUDENT_T_DEGREES + 1.0) * u / (STUDENT_T_DEGREES + u**2)
        return u

    def slope(self, u: Array) -> Array:
        """Derivative (m,) of psi by standardised residuals (m,)."""
        if self.name == "huber":
            return (np.abs(u) <= HUBER_K).astype(float)
        if self.name == "student_t":
            return (STUDENT_T_DEGREES + 1.0) * (STUDENT_T_DEGREES - u**2) / (STUDENT_T_DEGREES + u**2) ** 2
        return np.ones_like(u)

    def weights(self, u: Array) -> Array:
        """Weights psi(u) / u (m,), one where u is zero."""
        small = np.abs(u) < 1e-12
        return np.where(small, self.slope(u), self.psi(u) / np.where(small, 1.0, u))

    def inflation(self, u: Array, unknowns: int) -> float:
        """Ratio of the variance to that of (X'X)^-1; u (m,): standardised residuals of the solution."""
        slope = float(np.mean(self.slope(u)))
        correction = 1.0 + unknowns / len(u) * (1.0 - slope) / slope
        return correction**2 * float(np.sum(self.psi(u) ** 2)) / max(len(u) - unknowns, 1) / slope**2


LOSSES = ("auto", "squares", "huber", "student_t")  # auto: squares, unless there are outliers
OUTLIER_THRESHOLD = 5.0  # standard deviations between a sample and the median of its neighbourhood
HALF_WINDOW = 2  # samples on either side


def outlier_count(residual: Array) -> int:
    """Number of outliers among residuals (n, 2), NaN where nothing was measured.

    Hampel identifier on the difference of a residual from the median of five: errors that neighbours share,
    by a wrong model or autocorrelated noise, are no outliers. F. R. Hampel, J. Am. Stat. Assoc. 69 (1974),
    doi 10.1080/01621459.1974.10482962.
    """
    count = 0
    for channel in residual.T:
        values = channel[np.isfinite(channel)]
        if len(values) < MIN_SAMPLES:
            continue
        around = np.lib.stride_tricks.sliding_window_view(
            np.pad(values, HALF_WINDOW, mode="reflect"), 2 * HALF_WINDOW + 1
        )
        apart = np.abs(values - np.median(around, axis=1))
        # A sample often equals its median: only differences other than zero measure the scale.
        size = float(np.median(apart[apart > 0.0])) if apart.any() else 0.0
        count += int(np.count_nonzero(apart > OUTLIER_THRESHOLD * size / HAMPEL_MEDIAN))
    return count


def scale(residual: Array, unknowns: int) -> float:
    """Robust standard deviation of Gaussian noise by the median of |residual| (m,)."""
    spare = len(residual) / max(len(residual) - unknowns, 1)
    return float(np.median(np.abs(residual))) / NORMAL_MAD * float(np.sqrt(spare))
