"""What an estimator answers."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.stats import t as student_t
from tms_model.bicycle import Array


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
    def quantile(self) -> float:
        """Half of a 95 % interval per standard error: Student's t."""
        return float(student_t.ppf(0.975, max(self.degrees_of_freedom, 1)))

    @property
    def ci95(self) -> Array:
        """95 % intervals (p, 2), by Student's t: right for white residuals, too narrow for coloured ones."""
        half = self.quantile * self.std
        return np.stack([self.values - half, self.values + half], axis=1)
