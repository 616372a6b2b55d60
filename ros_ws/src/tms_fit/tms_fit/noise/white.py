"""White noise model with one variance for both channels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array


@dataclass(frozen=True, eq=False)
class White:
    """White noise of one standard deviation on all measured samples."""

    good: NDArray[np.bool_]  # (n, 2), measured
    std: float  # [rad/s]

    @property
    def parameters(self) -> dict[str, float]:
        """Standard deviation by name [rad/s]."""
        return {"noise_std": self.std}

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the covariance of all samples used."""
        return 2.0 * math.log(self.std) * int(self.good.sum()) if self.std > 0.0 else -math.inf

    def rows(self, values: Array) -> Array:
        """Whitened rows (m, ...) of unit variance for values (n, 2, ...)."""
        rows: Array = values[self.good] / (self.std or 1.0)
        return rows

    def at_samples(self, time: Array, good: NDArray[np.bool_]) -> White:
        """The same noise at other samples: times (n,) [s], measured (n, 2)."""
        return White(good, self.std)

    def innovations(self, residual: Array) -> Array:
        """Residuals (n, 2) in standard deviations; NaN where nothing was measured."""
        return np.where(self.good, residual, np.nan) / (self.std or 1.0)


def fit(time: Array, residual: Array, jacobian: Array) -> White:
    """White noise with the standard deviation of residuals (n, 2), less p degrees of freedom of the fit."""
    good = np.isfinite(residual)
    degrees = max(int(good.sum()) - jacobian.shape[2], 1)
    return White(good, math.sqrt(float(np.sum(residual[good] ** 2)) / degrees))
