"""What an estimator answers."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.stats import t as student_t
from tms_model.bicycle import Array

from tms_fit.settings import CHANNELS
from tms_fit.window import Window

LEAST_SAMPLES = 10  # scalar measurements beyond the number of unknowns
LEAST_SPAN = 0.25  # [s]
COLOURED = 0.3  # lag-one autocorrelation of the residuals above which they are called coloured


@dataclass(frozen=True, eq=False)
class Estimate:
    """Parameters of one free response with their uncertainty, or the reason why there are none."""

    estimator: str
    status: str  # ok, not_converged, not_observable, too_short
    message: str
    names: tuple[str, ...] = ()
    values: Array = field(default_factory=lambda: np.empty(0))  # (p,) SI
    covariance: Array = field(default_factory=lambda: np.empty((0, 0)))  # (p, p)
    degrees_of_freedom: int = 0
    residual_std: float = float("nan")  # [rad/s]
    vaf: dict[str, float] = field(default_factory=dict)  # per channel, 1 is perfect
    sample_count: int = 0  # scalar measurements used
    residual_autocorrelation: float = float(
        "nan"
    )  # at lag one, of the channel where it is largest; 0 when white

    @property
    def parameters(self) -> dict[str, float]:
        """Values by name."""
        return dict(zip(self.names, (float(value) for value in self.values), strict=True))

    @property
    def std(self) -> Array:
        """Standard errors (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def ci95(self) -> Array:
        """95 % intervals (p, 2), by Student's t: right for white residuals, too narrow for coloured ones."""
        half = student_t.ppf(0.975, max(self.degrees_of_freedom, 1)) * self.std
        return np.stack([self.values - half, self.values + half], axis=1)


def variance_accounted_for(window: Window, predicted: Array) -> dict[str, float]:
    """VAF = 1 - var(measured - predicted) / var(measured) for each channel that was measured."""
    answer = {}
    for channel, measured, model in zip(CHANNELS, window.measured.T, predicted.T, strict=True):
        good = np.isfinite(measured)
        if good.sum() > 1 and np.var(measured[good]) > 0.0:
            answer[channel] = float(1.0 - np.var(measured[good] - model[good]) / np.var(measured[good]))
    return answer


def lag_one_autocorrelation(window: Window, predicted: Array) -> float:
    """Autocorrelation of neighbouring residuals, of the channel where it is largest. White ones: near 0."""
    worst = float("nan")
    for residual in (window.measured - predicted).T:
        residual = residual[np.isfinite(residual)]
        if len(residual) > 2 and residual.any():
            centred = residual - residual.mean()
            worst = float(np.fmax(worst, centred[1:] @ centred[:-1] / (centred @ centred)))
    return worst


def caution(autocorrelation: float) -> str:
    """What to add to the message when the residuals are not white."""
    if not autocorrelation > COLOURED:
        return ""
    return (
        f"; neighbouring residuals are alike (autocorrelation {autocorrelation:.2f}): the model misses"
        " something and the interval is too narrow"
    )


def too_short(window: Window, free: tuple[str, ...]) -> str:
    """Why a window is too short to estimate `free`, or an empty text."""
    count = int(np.isfinite(window.measured).sum())
    span = float(window.time[-1]) if len(window.time) else 0.0
    if span < LEAST_SPAN or count < len(free) + LEAST_SAMPLES:
        return (
            f"expected at least {LEAST_SPAN} s and {len(free) + LEAST_SAMPLES} measurements after the strike"
            f" for {len(free)} unknowns, found {span:.3f} s and {count}"
        )
    return ""
