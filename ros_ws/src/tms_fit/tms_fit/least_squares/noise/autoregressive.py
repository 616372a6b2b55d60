"""Coloured noise: an autoregressive process of each channel, as the residuals show it.

    e[t] = r[t] - a_1 r[t-1] - ... - a_p r[t-p], white, of variance s^2

A second and a half of noise that is correlated over a fifth of a second says little about that correlation,
and the noise parameters of greatest likelihood, taken for the truth, give intervals that are far too narrow.
So the answer is an average over what the noise may be: the first reflection coefficient of each channel
(which for order one is the correlation of neighbours) runs over a grid, and so does the ratio of the two
channels' deviations; each combination has the weight of its restricted likelihood, which allows for what the
fit has taken out of the residuals, with a flat prior in
artanh r. Higher coefficients are Burg's, their number has
the least BIC.

References: H. D. Patterson and R. Thompson, Biometrika 58 (1971), doi 10.1093/biomet/58.3.545; D. A.
Harville, Biometrika 61 (1974), doi 10.1093/biomet/61.2.383, for its meaning as a posterior.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array

from tms_fit.least_squares.noise.process import ChannelNoise, burg, grid_places, process
from tms_fit.settings import CHANNELS

PLACES = np.linspace(-4.0, 9.0, 21)  # of the grid, in standard errors from Burg's coefficient, in artanh
RATIOS = np.linspace(-2.5, 2.5, 5)  # of the grid, in standard errors of the logarithm of the ratio
CLEAR = 6.0  # fall of BIC from which on residuals are called coloured: once in 500 white channels
LIMIT = 3.5  # largest artanh of a reflection coefficient: 0.998


@dataclass(frozen=True, eq=False)
class Posterior:
    """What residuals say about the noise, and with it about the parameters they were left by."""

    best: tuple[int, ...]  # likeliest member of each channel's family
    stds: tuple[float, ...]  # its innovations' deviation [rad/s]
    shift: Array  # (p,) mean change of the parameters
    covariance: Array  # (p, p)


@dataclass(frozen=True, eq=False)
class Autoregressive:
    """An autoregressive process on each channel that was measured: the likeliest, and others beside it."""

    good: NDArray[np.bool_]  # (n, 2), measured
    families: dict[int, tuple[ChannelNoise, ...]]  # what each channel's noise may be, of deviation one
    channels: dict[int, ChannelNoise]  # what is likeliest

    @property
    def parameters(self) -> dict[str, float]:
        """Innovation deviation and coefficients of each channel."""
        found = {}
        for channel, noise in self.channels.items():
            name = CHANNELS[channel]
            found[f"{name}_innovation_std"] = noise.std
            for k, weight in enumerate(noise.process.filters[-1]):
                found[f"{name}_ar{k + 1}"] = float(weight)
        return found

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
            white[self.good[:, c], c] = noise.rows(residual[self.good[:, c], c])[noise.places]
        return white

    def average(self, residual: Array, jacobian: Array, information: Array) -> tuple[Array, Array]:
        """Mean change (p,) of the parameters and their covariance (p, p) over what the noise may be.

        residual (n, 2) and jacobian (n, 2, p) at the solution; information (p, p): what priors add.
        """
        posterior = _posterior(self.families, self.good, residual, jacobian, information)
        return posterior.shift, posterior.covariance


def fit(time: Array, residual: Array, jacobian: Array) -> Autoregressive:
    """The noise that residuals (n, 2) show, whose fit had the derivatives (n, 2, p)."""
    good = np.isfinite(residual)
    places = grid_places(time)
    families = {
        c: _family(places[good[:, c]], residual[good[:, c], c]) for c in range(2) if good[:, c].sum() > 2
    }
    posterior = _posterior(families, good, residual, jacobian, np.zeros((jacobian.shape[2],) * 2))
    channels = {
        c: ChannelNoise(family[best].process, std, family[best].places, family[best].count)
        for (c, family), best, std in zip(families.items(), posterior.best, posterior.stds, strict=False)
    }
    return Autoregressive(good, families, channels)


def remembers(residual: Array) -> bool:
    """Whether residuals (n, 2) of some channel are no white noise: BIC falls by more than CLEAR."""
    for channel in residual.T:
        values = channel[np.isfinite(channel)]
        if len(values) > 2 and values.any():
            reflections, std = burg(values)
            fall = -len(values) * math.log(std**2 / float(np.mean(values**2)))
            if fall - len(reflections) * math.log(len(values)) > CLEAR:
                return True
    return False


def _family(places: NDArray[np.int_], residual: Array) -> tuple[ChannelNoise, ...]:
    """What a channel's noise may be: one member if it shows no memory at all."""
    grid = places - places[0]
    reflections, _ = burg(residual)
    if not len(reflections):
        return (ChannelNoise(process(reflections), 1.0, grid, int(grid[-1]) + 1),)
    first = float(np.clip(reflections[0], -0.99, 0.99))
    std = 1.0 / math.sqrt(len(residual) * (1.0 - first**2))
    around = np.clip(math.atanh(first) + std * PLACES, -LIMIT, LIMIT)
    return tuple(
        ChannelNoise(process(np.append(one, reflections[1:])), 1.0, grid, int(grid[-1]) + 1)
        for one in np.unique(np.tanh(around))
    )


def _posterior(
    families: dict[int, tuple[ChannelNoise, ...]],
    good: NDArray[np.bool_],
    residual: Array,
    jacobian: Array,
    information: Array,
) -> Posterior:
    """Weights of all combinations by restricted likelihood, the common variance integrated out."""
    values = np.concatenate([jacobian, residual[:, :, None]], axis=2)
    products, prior = [], []
    for c, family in families.items():
        rows = [noise.rows(values[good[:, c], c]) for noise in family]
        products.append(np.array([one.T @ one for one in rows]))
        prior.append(np.array([-0.5 * noise.log_determinant for noise in family]))
    counts = [int(good[:, c].sum()) for c in families]
    ratios = _ratios(products, counts)
    grams = products[0][:, None, None]
    logs = prior[0][:, None, None] + np.zeros((1, 1, len(ratios)))
    if len(families) == 2:
        grams = grams + products[1][None, :, None] * np.exp(-2.0 * ratios)[None, None, :, None, None]
        logs = logs + prior[1][None, :, None] - counts[1] * ratios
    return _average(grams, logs, ratios, sum(counts), information)


def _average(grams: Array, logs: Array, ratios: Array, count: int, information: Array) -> Posterior:
    """Posterior by products of whitened values (g, h, r, p + 1, p + 1), the residual's last."""
    size = grams.shape[-1] - 1
    scale = np.sqrt(np.diagonal(grams, axis1=-2, axis2=-1).max(axis=(0, 1, 2))[:size])
    scale[scale == 0.0] = 1.0
    normal = grams[..., :size, :size] / np.outer(scale, scale)
    degrees = count - size
    rough = float(grams[..., size, size].min()) / count  # a variance, by which priors are weighed
    normal = normal + rough * information / np.outer(scale, scale)
    inverse = np.linalg.inv(normal)
    shifts = np.einsum("...ij,...j->...i", inverse, grams[..., :size, size] / scale)
    squares = grams[..., size, size] - np.einsum("...i,...i->...", shifts, grams[..., :size, size] / scale)
    logs = logs - 0.5 * degrees * np.log(squares) - 0.5 * np.linalg.slogdet(normal)[1]
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    variances = weights * squares / degrees
    mean = np.einsum("ghr,ghri->i", weights, shifts)
    off = shifts - mean
    spread = np.einsum("ghr,ghri,ghrj->ij", weights, off, off)
    spread += np.einsum("ghr,ghrij->ij", variances, inverse)
    best = np.unravel_index(int(logs.argmax()), logs.shape)
    std = math.sqrt(float(squares[best]) / degrees)
    return Posterior(
        best=(int(best[0]), int(best[1])),
        stds=(std, std * math.exp(float(ratios[best[2]]))),
        shift=mean / scale,
        covariance=spread / np.outer(scale, scale),
    )


def _ratios(products: list[Array], counts: list[int]) -> Array:
    """Logarithms of the second channel's deviation per the first's, around what the residuals show."""
    if len(products) < 2:
        return np.zeros(1)
    least = [float(one[:, -1, -1].min()) / count for one, count in zip(products, counts, strict=True)]
    std = math.sqrt(0.5 / counts[0] + 0.5 / counts[1])
    return 0.5 * math.log(max(least[1], 1e-300) / max(least[0], 1e-300)) + std * RATIOS
