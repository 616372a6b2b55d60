"""Noise that remembers, of one kind on each channel: the likeliest, and others beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array

from tms_fit.noise.posterior import ChannelNoise, Family, posterior
from tms_fit.parameters import CHANNELS


@dataclass(frozen=True, eq=False)
class ColoredNoise:
    """A process on each channel that was measured."""

    good: NDArray[np.bool_]  # (n, 2), measured
    families: Mapping[int, Family]  # what each channel's noise may be
    channels: Mapping[int, ChannelNoise]  # what is likeliest

    @property
    def parameters(self) -> dict[str, float]:
        """Those of each channel."""
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
        """Values (n, 2, ...) as rows (m, ...) of variance one; more than samples where some are missing."""
        parts = [noise.rows(values[self.good[:, c], c]) for c, noise in self.channels.items()]
        return np.concatenate(parts) if parts else np.empty((0, *values.shape[2:]))

    def innovations(self, residual: Array) -> Array:
        """Residuals (n, 2) made white, of variance one."""
        white = np.full(residual.shape, np.nan)
        for c, noise in self.channels.items():
            white[self.good[:, c], c] = noise.innovations(residual[self.good[:, c], c])
        return white

    def average(self, residual: Array, jacobian: Array, prior: tuple[Array, Array]) -> tuple[Array, Array]:
        """Mean change (p,) of the parameters and their covariance (p, p) over what the noise may be.

        residual (n, 2) and jacobian (n, 2, p) at the solution; prior: rows (k, p) that priors add, and
        how far (k,) the solution is from them.
        """
        found = posterior(self.families, self.good, residual, jacobian, prior)
        return found.shift, found.covariance


def colored_noise(
    families: Mapping[int, Family], good: NDArray[np.bool_], residual: Array, jacobian: Array
) -> ColoredNoise:
    """The noise of families by channel that residuals (n, 2) show, whose fit had derivatives (n, 2, p)."""
    if not families:
        return ColoredNoise(good, {}, {})
    found = posterior(families, good, residual, jacobian)
    channels = {
        c: family.member(best, std)
        for (c, family), best, std in zip(families.items(), found.best, found.stds, strict=False)
    }
    return ColoredNoise(good, families, channels)
