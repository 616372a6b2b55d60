"""White noise of one variance for both channels."""

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
        """The standard deviation."""
        return {"noise_std": self.std}

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the covariance of all samples used."""
        return 2.0 * math.log(self.std) * int(self.good.sum()) if self.std > 0.0 else -math.inf

    def rows(self, values: Array) -> Array:
        """Values (n, 2, ...) as rows (m, ...) of variance one."""
        rows: Array = values[self.good] / (self.std or 1.0)
        return rows

    def innovations(self, residual: Array) -> Array:
        """Residuals (n, 2) per standard deviation."""
        return np.where(self.good, residual, np.nan) / (self.std or 1.0)


def fit(time: Array, residual: Array, jacobian: Array) -> White:
    """The standard deviation that residuals (n, 2) show, for as many unknowns as jacobian (n, 2, p) has."""
    good = np.isfinite(residual)
    degrees = max(int(good.sum()) - jacobian.shape[2], 1)
    return White(good, math.sqrt(float(np.sum(residual[good] ** 2)) / degrees))
