"""Parameters and their covariance averaged over what the noise may be.

Each channel has a family of candidates; each combination of candidates, and of ratios between the channels'
deviations, has the weight of its restricted likelihood, which allows for what the fit has taken out of the
residuals; the common variance is integrated out.

References: H. D. Patterson and R. Thompson, Biometrika 58 (1971), doi 10.1093/biomet/58.3.545; D. A.
Harville, Biometrika 61 (1974), doi 10.1093/biomet/61.2.383, for its meaning as a posterior.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array

LEAST = 1e-10  # smallest singular value of the derivatives, per largest, that counts
CANCELLED = 1e-12  # of a sum of squares: what is left of it after subtraction has no true digits below this
RATIOS = np.linspace(-2.5, 2.5, 5)  # of the grid, in standard errors of the logarithm of the ratio


class ChannelNoise(Protocol):
    """Noise of one channel, with all its parameters."""

    @property
    def parameters(self) -> Mapping[str, float]:
        """By name, SI."""

    @property
    def log_determinant(self) -> float:
        """Of the covariance of the samples."""

    def rows(self, values: Array) -> Array:
        """Values (m, ...) of the samples as rows of variance one; as many, or more where some are missing."""

    def innovations(self, values: Array) -> Array:
        """Values (m,) of the samples made white, of variance one."""


class Family(Protocol):
    """What one channel's noise may be: g candidates in units of a deviation of one."""

    @property
    def log_determinants(self) -> Array:
        """Of each candidate's covariance (g,)."""

    def products(self, values: Array) -> Array:
        """Whitened values' products (g, q, q), of values (m, q) of the samples."""

    def member(self, index: int, std: float) -> ChannelNoise:
        """One candidate at a deviation [rad/s]."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """What residuals say about the noise, and with it about the parameters they were left by."""

    best: tuple[int, ...]  # likeliest member of each channel's family
    stds: tuple[float, ...]  # its deviation [rad/s]
    shift: Array  # (p,) mean change of the parameters
    covariance: Array  # (p, p)


def posterior(
    families: Mapping[int, Family],
    good: NDArray[np.bool_],
    residual: Array,
    jacobian: Array,
    held: tuple[Array, Array] | None = None,
) -> Posterior:
    """Weights of all combinations by restricted likelihood.

    residual (n, 2) and jacobian (n, 2, p) at the solution, good (n, 2) what was measured; held: rows (k, p)
    that priors add, and how far (k,) the solution is from them.
    """
    back = orthogonal(np.concatenate([jacobian[good[:, c], c] for c in families]))
    values = np.concatenate([jacobian @ back, residual[:, :, None]], axis=2)
    products = [family.products(values[good[:, c], c]) for c, family in families.items()]
    prior = [-0.5 * family.log_determinants for family in families.values()]
    counts = [int(good[:, c].sum()) for c in families]
    ratios = _ratios(products, counts)
    grams = products[0][:, None, None]
    logs = prior[0][:, None, None] + np.zeros((1, 1, len(ratios)))
    if len(families) == 2:
        grams = grams + products[1][None, :, None] * np.exp(-2.0 * ratios)[None, None, :, None, None]
        logs = logs + prior[1][None, :, None] - counts[1] * ratios
    rows, off = (np.zeros((0, len(back))), np.zeros(0)) if held is None else held
    extra = np.concatenate([rows @ back, off[:, None]], axis=1)
    known = extra.T @ extra
    found = _average(grams, logs, ratios, sum(counts), known)
    return Posterior(found.best, found.stds, back @ found.shift, back @ found.covariance @ back.T)


def orthogonal(jacobian: Array) -> Array:
    """Matrix (p, k) that makes derivatives (m, p) orthonormal columns (m, k).

    In that basis normal equations don't cost half of the digits; a direction that nothing tells is left out.
    """
    scale = np.linalg.norm(jacobian, axis=0)
    scale[scale == 0.0] = 1.0
    _, singular, rows = np.linalg.svd(jacobian / scale, full_matrices=False)
    kept = singular > LEAST * singular[:1]
    basis: Array = rows[kept].T / singular[kept] / scale[:, None]
    return basis


def _average(grams: Array, logs: Array, ratios: Array, count: int, known: Array) -> Posterior:
    """Posterior by products of whitened values (g, h, r, p + 1, p + 1), the residual's last.

    known (p + 1, p + 1): the same of the priors' rows.
    """
    size = grams.shape[-1] - 1
    rough = float(grams[..., size, size].min()) / count  # a variance, by which priors are weighed
    grams = grams + rough * known
    scale = np.sqrt(np.diagonal(grams, axis1=-2, axis2=-1).max(axis=(0, 1, 2))[:size])
    scale[scale == 0.0] = 1.0
    normal = grams[..., :size, :size] / np.outer(scale, scale)
    degrees = count - size
    whole = grams[..., size, size]
    normal = normal + CANCELLED * np.eye(
        size
    )  # a direction that only a channel of no weight tells stays finite
    inverse = np.linalg.inv(normal)
    shifts = np.einsum("...ij,...j->...i", inverse, grams[..., :size, size] / scale)
    explained = np.einsum("...i,...i->...", shifts, grams[..., :size, size] / scale)
    squares = np.maximum(whole - explained, CANCELLED * whole)  # without noise the difference is rounding
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
