"""Noise models of the measurements by name. A new one: one file here and one line below.

Each is a function (time, residual, jacobian) -> Noise. It estimates its parameters from the residuals (n, 2)
[rad/s] of a fit at times (n,) [s], NaN where nothing was measured. The derivatives (n, 2, p) of the
prediction by the fitted parameters correct for the degrees of freedom that the fit removed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array

from tms_fit.noise import ar, oscillator, white


class Noise(Protocol):
    """Noise model with its parameters."""

    @property
    def parameters(self) -> Mapping[str, float]:
        """Parameters by name, SI."""

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the covariance of all samples used."""

    def rows(self, values: Array) -> Array:
        """Whitened rows (m, ...) of unit variance for values (n, 2, ...) of both channels."""

    def innovations(self, residual: Array) -> Array:
        """Whitened residuals (n, 2) of unit variance; NaN where nothing was measured."""

    def at_samples(self, time: Array, good: NDArray[np.bool_]) -> Noise:
        """The same noise at other samples: times (n,) [s], measured (n, 2)."""


NoiseModel = Callable[[Array, Array, Array], Noise]

NOISES: dict[str, NoiseModel] = {
    "white": white.fit,
    "ar": ar.fit,
    "oscillator": oscillator.fit,
}


def likeliest(
    time: Array, residual: Array, jacobian: Array, stated: tuple[float, ...] = ()
) -> tuple[str, Noise]:
    """Name and noise of the lower BIC: autoregressive or oscillator; stated: known numbers of the latter."""
    count = int(np.isfinite(residual).sum())

    def bic(noise: Noise) -> float:
        rows = noise.rows(residual)
        return float(rows @ rows) + noise.log_determinant + len(noise.parameters) * math.log(count)

    rivals: dict[str, Noise] = {
        "ar": ar.fit(time, residual, jacobian),
        "oscillator": oscillator.fit(time, residual, jacobian, stated),
    }
    return min(rivals.items(), key=lambda one: bic(one[1]))
