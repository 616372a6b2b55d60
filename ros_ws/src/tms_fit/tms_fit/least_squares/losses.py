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

HUBER = 1.345  # standard deviations from which on a residual counts less: 95 % efficient on Gaussian noise
DEGREES = 4.0  # of freedom of Student's t
APART = 0.685  # median of |u less the median of five|, where that isn't zero, for Gaussian white noise
LEAST_JUDGED = 20  # samples of a channel; fewer show no outliers
MAD = 0.6744897501960817  # median of |u| for Gaussian noise of deviation one


@dataclass(frozen=True)
class Loss:
    """A loss by its name."""

    name: str  # of LOSSES

    def psi(self, u: Array) -> Array:
        """Derivative of the cost, of standardised residuals (m,)."""
        if self.name == "huber":
            return np.clip(u, -HUBER, HUBER)
        if self.name == "student_t":
            return (DEGREES + 1.0) * u / (DEGREES + u**2)
        return u

    def slope(self, u: Array) -> Array:
        """Derivative of psi."""
        if self.name == "huber":
            return (np.abs(u) <= HUBER).astype(float)
        if self.name == "student_t":
            return (DEGREES + 1.0) * (DEGREES - u**2) / (DEGREES + u**2) ** 2
        return np.ones_like(u)

    def weights(self, u: Array) -> Array:
        """psi(u) / u (m,), one where u is zero."""
        small = np.abs(u) < 1e-12
        return np.where(small, self.slope(u), self.psi(u) / np.where(small, 1.0, u))

    def inflation(self, u: Array, unknowns: int) -> float:
        """By what the variance exceeds that of (X'X)^-1, u (m,) standardised residuals of the solution."""
        slope = float(np.mean(self.slope(u)))
        correction = 1.0 + unknowns / len(u) * (1.0 - slope) / slope
        return correction**2 * float(np.sum(self.psi(u) ** 2)) / max(len(u) - unknowns, 1) / slope**2


LOSSES = ("auto", "squares", "huber", "student_t")  # auto: squares, unless there are outliers
OUTLIER = 5.0  # standard deviations from the median of its neighbours, at which a sample is one
NEIGHBOURS = 2  # on either side


def outlier_count(residual: Array) -> int:
    """How many residuals (n, 2), NaN where nothing was measured, stand apart from their neighbours.

    Hampel's identifier on what a residual differs from the median of five: what neighbours share, a wrong
    model or coloured noise, is no outlier. F. R. Hampel, J. Am. Stat. Assoc. 69 (1974), doi
    10.1080/01621459.1974.10482962.
    """
    count = 0
    for channel in residual.T:
        values = channel[np.isfinite(channel)]
        if len(values) < LEAST_JUDGED:
            continue
        around = np.lib.stride_tricks.sliding_window_view(
            np.pad(values, NEIGHBOURS, mode="reflect"), 2 * NEIGHBOURS + 1
        )
        apart = np.abs(values - np.median(around, axis=1))
        # A sample is often its own median: the others tell how far they stand apart.
        size = float(np.median(apart[apart > 0.0])) if apart.any() else 0.0
        count += int(np.count_nonzero(apart > OUTLIER * size / APART))
    return count


def scale(residual: Array, unknowns: int) -> float:
    """Standard deviation of Gaussian noise by the median of |residual| (m,), unmoved by outliers."""
    spare = len(residual) / max(len(residual) - unknowns, 1)
    return float(np.median(np.abs(residual))) / MAD * float(np.sqrt(spare))
