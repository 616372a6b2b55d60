"""What an estimator answers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import t as student_t
from tms_model.bicycle import Array

from tms_fit.parameters import shaping
from tms_fit.settings import Settings


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
    known: Mapping[str, float] = field(default_factory=dict)  # values of all parameters that were not free
    predicted: Array = field(default_factory=lambda: np.empty((0, 2)))  # (n, 2) [rad/s]
    residual: Array = field(default_factory=lambda: np.empty((0, 2)))  # (n, 2) [rad/s], NaN: not used
    whitened: Array = field(default_factory=lambda: np.empty((0, 2)))  # (n, 2), unit variance if all is right
    jacobian: Array = field(default_factory=lambda: np.empty((0, 2, 0)))  # (n, 2, p) of predicted by values
    noise: Mapping[str, float] = field(default_factory=dict)  # parameters of the noise model, by name
    noise_model: str = "white"
    loss: str = "squares"  # of LOSSES, as used
    chosen: tuple[str, ...] = ()  # what the data decided where the settings left it open, and why
    log_likelihood: float = float("nan")  # at the maximum, noise parameters included
    unknown_count: int = 0  # of the likelihood: parameters and noise parameters
    settings: Settings | None = None  # as asked for
    intervals: Array | None = None  # (p, 2) 95 % intervals by another way than the covariance

    @property
    def parameters(self) -> dict[str, float]:
        """Values by name."""
        return dict(zip(self.names, (float(value) for value in self.values), strict=True))

    @property
    def complete(self) -> dict[str, float]:
        """All values that make the prediction, found and known."""
        return {**self.known, **self.parameters}

    @property
    def nonlinear(self) -> dict[str, float]:
        """Those of `complete` that `tms_fit.response.prediction.predictor` must be told."""
        return shaping(self.complete)

    @property
    def std(self) -> Array:
        """Standard errors (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> Array:
        """Correlation matrix (p, p)."""
        correlation: Array = self.covariance / np.outer(self.std, self.std)
        return correlation

    @property
    def quantile(self) -> float:
        """Half of a 95 % interval per standard error: Student's t."""
        return float(student_t.ppf(0.975, max(self.degrees_of_freedom, 1)))

    @property
    def ci95(self) -> Array:
        """95 % intervals (p, 2): `intervals`, or by Student's t, right if the noise is as its model says."""
        if self.intervals is not None:
            return self.intervals
        half = self.quantile * self.std
        return np.stack([self.values - half, self.values + half], axis=1)

    @property
    def aic(self) -> float:
        """Akaike's criterion; smaller is better, among fits of the same samples."""
        return 2.0 * self.unknown_count - 2.0 * self.log_likelihood

    @property
    def bic(self) -> float:
        """Schwarz's criterion; smaller is better, among fits of the same samples."""
        return self.unknown_count * math.log(max(self.sample_count, 1)) - 2.0 * self.log_likelihood
