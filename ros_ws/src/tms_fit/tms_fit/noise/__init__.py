"""Models of the measurement noise by name. A new one: one file here and one line below.

Each is a function (time, residual, jacobian) -> Noise: it estimates its own parameters from the residuals
(n, 2) of a fit [rad/s] at times (n,) [s], NaN where nothing was measured, and from the derivatives (n, 2, p)
of the prediction by what was fitted, by which residuals are smaller than the noise that they stand for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from tms_model.bicycle import Array

from tms_fit.noise import ar, oscillator, white


class Noise(Protocol):
    """A noise model with its parameters."""

    @property
    def parameters(self) -> Mapping[str, float]:
        """Parameters by name, SI."""

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the covariance of all samples used."""

    def rows(self, values: Array) -> Array:
        """Values of both channels (n, 2, ...) as rows (m, ...) whose noise is white, of variance one."""

    def innovations(self, residual: Array) -> Array:
        """Residuals (n, 2) made white, of variance one; NaN where nothing was measured."""


NoiseModel = Callable[[Array, Array, Array], Noise]

NOISES: dict[str, NoiseModel] = {
    "white": white.fit,
    "ar": ar.fit,
    "oscillator": oscillator.fit,
}
