"""Autocorrelated noise, one model per channel: the likeliest candidate and its alternatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array

from tms_fit.noise.posterior import ChannelNoise, Family, Piece, Posterior, posterior
from tms_fit.parameters import CHANNELS


@dataclass(frozen=True, eq=False)
class ColoredNoise:
    """Noise process of each measured channel, with candidates."""

    good: NDArray[np.bool_]  # (n, 2), measured
    families: Mapping[int, Family]  # candidates by channel
    channels: Mapping[int, ChannelNoise]  # the likeliest candidate by channel

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters of each channel by name, SI."""
        return {
            f"{CHANNELS[c]}_{name}": value
            for c, noise in self.channels.items()
            for name, value in noise.parameters.items()
        }

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the covariance of all samples used."""
        return sum(noise.log_determinant for noise in self.channels.values())

    def rows(self, values: Array) -> Array:
        """Whitened rows (m, ...) of unit variance for values (n, 2, ...); more rows with missing samples."""
        parts = [noise.rows(values[self.good[:, c], c]) for c, noise in self.channels.items()]
        return np.concatenate(parts) if parts else np.empty((0, *values.shape[2:]))

    def innovations(self, residual: Array) -> Array:
        """Whitened residuals (n, 2) of unit variance; NaN where nothing was measured."""
        white = np.full(residual.shape, np.nan)
        for c, noise in self.channels.items():
            white[self.good[:, c], c] = noise.innovations(residual[self.good[:, c], c])
        return white

    def at_samples(self, time: Array, good: NDArray[np.bool_]) -> ColoredNoise:
        """The likeliest noise at other samples, independent of these: times (n,) [s], measured (n, 2)."""
        channels = {c: noise.at(time[good[:, c]]) for c, noise in self.channels.items() if good[:, c].any()}
        return ColoredNoise(good, {}, channels)

    def average(self, residual: Array, jacobian: Array, prior: tuple[Array, Array]) -> tuple[Array, Array]:
        """Mean change (p,) of the parameters and their covariance (p, p), averaged over the candidates.

        residual (n, 2) and jacobian (n, 2, p) at the solution; prior: rows (k, p) of the priors and their
        residuals (k,).
        """
        if not self.families:
            count = jacobian.shape[2]
            return np.zeros(count), np.zeros((count, count))
        found = posterior([_one_run(self.families, residual, jacobian)], prior, with_own=False)
        return found.shift, found.covariance


def colored_noise(families: Mapping[int, Family], residual: Array, jacobian: Array) -> ColoredNoise:
    """Likeliest noise from residuals (n, 2) of a fit with derivatives (n, 2, p); families: candidates."""
    good = np.isfinite(residual)
    if not families:
        return ColoredNoise(good, {}, {})
    no_prior = np.empty((0, jacobian.shape[2])), np.empty(0)
    piece = _one_run(families, residual, jacobian)
    return likeliest_noise(piece, posterior([piece], no_prior, with_own=False))


def likeliest_noise(piece: Piece, found: Posterior) -> ColoredNoise:
    """Noise of the combination of largest weight, at the samples of one run."""
    channels = {c: family.member(found.best[c], found.stds[c]) for c, family in piece.families.items()}
    return ColoredNoise(np.isfinite(piece.residual), piece.families, channels)


def _one_run(families: Mapping[int, Family], residual: Array, jacobian: Array) -> Piece:
    own = np.empty((*residual.shape, 0))
    return Piece(families, own, jacobian, residual, (np.empty((0, 0)), np.empty(0)))
