"""Kalman filter that whitens a stochastic, lightly damped oscillator under white noise.

    z[k] = exp((-1/tau + 2 pi i f) dt) z[k-1] + w[k],   y[k] = Re z[k] + v[k],   var v = 1,  var Re z = s^2

Shimmy is such a process: a limit cycle of constant amplitude whose phase diffuses within tau. The state space
is that of `tms_fit.kalman.state_space.with_oscillator`. Standardised innovations are white, and the sum of
the logarithms of their variances is the log-determinant (F. C. Schweppe, IEEE Trans. Inf. Theory 11 (1965),
doi 10.1109/TIT.1965.1053737). Samples may have any times; all candidates are filtered at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from tms_model.bicycle import Array


@dataclass(frozen=True, eq=False)
class Oscillations:
    """Candidate oscillators (g) of a channel, each under white noise of unit standard deviation."""

    time: Array  # (m,) [s] of the samples, ascending
    frequency: Array  # (g,) [Hz]
    decay_time: Array  # (g,) [s] of the phase correlation
    ratio: Array  # (g,) standard deviation of the oscillation relative to the white noise; 0: none

    @cached_property
    def _filter(self) -> tuple[Array, Array, Array]:
        """Transitions (m, g) and gains (m, g), complex, and standard deviations (m, g) of the innovations."""
        steps = np.diff(self.time, prepend=self.time[:1])
        rate = -1.0 / self.decay_time + 2j * math.pi * self.frequency
        turns = np.exp(steps[:, None] * rate)
        squares = self.ratio**2
        gains = np.empty(turns.shape, dtype=complex)
        variances = np.empty(turns.shape)
        # Variances of Re z and Im z and their covariance, which rotate and decay from sample to sample.
        real, cross, imaginary = squares.copy(), np.zeros_like(squares), squares.copy()
        kept = np.abs(turns) ** 2
        cos, sin = turns.real, turns.imag
        driven = squares * (1.0 - kept)
        for k in range(len(self.time)):
            c, s = cos[k], sin[k]
            real, cross, imaginary = (
                c * c * real - 2.0 * c * s * cross + s * s * imaginary + driven[k],
                c * s * (real - imaginary) + (c * c - s * s) * cross,
                s * s * real + 2.0 * c * s * cross + c * c * imaginary + driven[k],
            )
            variances[k] = real + 1.0
            gains[k] = (real + 1j * cross) / variances[k]
            real, cross, imaginary = (
                real / variances[k],
                cross / variances[k],
                imaginary - cross * cross / variances[k],
            )
        return turns, gains, np.sqrt(variances)

    def whitened(self, values: Array) -> Array:
        """Whitened values (m, g, q) by each candidate, for values (m, q) of the samples."""
        if not self.ratio.any():
            return np.repeat(values[:, None], len(self.ratio), axis=1)
        turns, gains, deviations = self._filter
        state = np.zeros((len(self.ratio), values.shape[1]), dtype=complex)
        white = np.empty((len(values), *state.shape))
        for k, sample in enumerate(values):
            state = turns[k][:, None] * state
            off = sample - state.real
            state = state + gains[k][:, None] * off
            white[k] = off / deviations[k][:, None]
        return white

    @property
    def log_determinants(self) -> Array:
        """Logarithm of the determinant (g,) of each candidate's covariance."""
        if not self.ratio.any():
            return np.zeros(len(self.ratio))
        found: Array = 2.0 * np.sum(np.log(self._filter[2]), axis=0)
        return found

    def products(self, values: Array) -> Array:
        """Products (g, q, q) of whitened values, for values (m, q) of the samples."""
        white = np.moveaxis(self.whitened(values), 1, 0)
        products: Array = np.swapaxes(white, 1, 2) @ white
        return products

    def member(self, index: int, std: float) -> OscillatorNoise:
        """One candidate with white noise of standard deviation std [rad/s]."""
        one = slice(index, index + 1)
        return OscillatorNoise(
            Oscillations(self.time, self.frequency[one], self.decay_time[one], self.ratio[one]), std
        )


@dataclass(frozen=True, eq=False)
class OscillatorNoise:
    """Oscillator noise of one channel."""

    shape: Oscillations  # one candidate
    std: float  # [rad/s] of the white noise

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters of the white noise and of the oscillator, if any, by name, SI."""
        white = {"noise_std": self.std}
        if not self.shape.ratio[0]:
            return white
        return {
            **white,
            "oscillator_frequency": float(self.shape.frequency[0]),
            "oscillator_decay_time": float(self.shape.decay_time[0]),
            "oscillator_std": float(self.shape.ratio[0]) * self.std,
        }

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the samples' covariance."""
        return float(self.shape.log_determinants[0]) + 2.0 * math.log(self.std) * len(self.shape.time)

    def at(self, time: Array) -> OscillatorNoise:
        """The same noise at other samples (m,) [s]."""
        shape = self.shape
        return OscillatorNoise(Oscillations(time, shape.frequency, shape.decay_time, shape.ratio), self.std)

    def rows(self, values: Array) -> Array:
        """Whitened rows (m, ...) of unit variance for values (m, ...) of the samples."""
        flat = values.reshape(len(values), -1)
        rows: Array = self.shape.whitened(flat)[:, 0].reshape(values.shape) / self.std
        return rows

    def innovations(self, values: Array) -> Array:
        """Whitened values (m,) of unit variance at the samples."""
        return self.rows(values)
