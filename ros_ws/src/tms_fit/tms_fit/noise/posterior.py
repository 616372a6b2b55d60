"""Posterior distribution of the noise model, and unknowns averaged over it, for one run or several.

Each channel has a family of candidate noise models, the same for all runs. The weight of a combination of
candidates of the two channels and of the ratio of their standard deviations is its restricted likelihood, in
which the fitted unknowns and the common variance are integrated out. A run's own unknowns are eliminated from
its rows for each combination (block elimination), so the cost grows with the number of runs, not with its
square. One run is one piece without unknowns of its own.

References: H. D. Patterson and R. Thompson, Biometrika 58 (1971), doi 10.1093/biomet/58.3.545; D. A.
Harville, Biometrika 61 (1974), doi 10.1093/biomet/61.2.383, for its meaning as a posterior.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from tms_model.bicycle import Array

SMALLEST_SINGULAR_VALUE = 1e-10  # of the scaled derivatives, relative to the largest
ROUNDING = 1e-12  # relative rounding error of a difference of two sums of squares
RATIO_STEPS = np.linspace(-2.5, 2.5, 5)  # of the grid, in standard errors of the logarithm of the ratio


class ChannelNoise(Protocol):
    """Noise of one channel with its parameters."""

    @property
    def parameters(self) -> Mapping[str, float]:
        """Parameters by name, SI."""

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the samples' covariance."""

    def rows(self, values: Array) -> Array:
        """Whitened rows of unit variance for values (m, ...); more than m with missing samples."""

    def innovations(self, values: Array) -> Array:
        """Whitened values (m,) of unit variance at the samples."""

    def at(self, time: Array) -> ChannelNoise:
        """The same noise at other samples (m,) [s]."""


class Family(Protocol):
    """Candidate noise models (g) of one channel with innovations of unit standard deviation."""

    @property
    def log_determinants(self) -> Array:
        """Logarithm of the determinant (g,) of each candidate's covariance."""

    def products(self, values: Array) -> Array:
        """Products (g, q, q) of whitened values, for values (m, q) of the samples."""

    def member(self, index: int, std: float) -> ChannelNoise:
        """One candidate with innovations of standard deviation std [rad/s]."""


@dataclass(frozen=True, eq=False)
class Piece:
    """One run linearised at its solution, with its candidate noise models."""

    families: Mapping[int, Family]  # of each channel that was measured
    own: Array  # (n, 2, q) derivatives by its own unknowns
    shared: Array  # (n, 2, s) derivatives by unknowns that all runs share
    residual: Array  # (n, 2) [rad/s], NaN: not measured
    prior: tuple[Array, Array]  # rows (k, q) of priors on its own unknowns and their residuals (k,)


@dataclass(frozen=True, eq=False)
class Posterior:
    """Weights of all combinations (g, h, r), and the unknowns averaged over them."""

    weights: Array  # (g, h, r) candidates of the first channel, of the second, ratios
    variances: Array  # (g, h, r) [rad^2/s^2] of the first channel's innovations
    ratios: Array  # (r,) log standard deviation of the second channel relative to the first
    shift: Array  # (s,) mean change of the shared unknowns
    covariance: Array  # (s, s)
    own_shift: tuple[Array, ...]  # (q,) of each run
    own_covariance: tuple[Array, ...]  # (q, q)

    @property
    def best(self) -> tuple[int, int, int]:
        """Indices of the combination of largest weight."""
        first, second, ratio = np.unravel_index(int(self.weights.argmax()), self.weights.shape)
        return int(first), int(second), int(ratio)

    @property
    def stds(self) -> tuple[float, float]:
        """Standard deviations [rad/s] of the channels' innovations in the combination of largest weight."""
        std = math.sqrt(float(self.variances[self.best]))
        return std, std * math.exp(float(self.ratios[self.best[2]]))


@dataclass(frozen=True, eq=False)
class _Basis:
    """Orthonormal basis of a run's own unknowns, and of the shared ones orthogonal to them."""

    own: Array  # T (q, q')
    leak: Array  # K (q, s) of the shared unknowns into the run's own
    shared: Array  # W (s, s')

    @property
    def matrix(self) -> Array:
        """Matrix (q + s + 1, q' + s' + 1) for derivatives by own and shared unknowns and the residual."""
        (q, a), (s, b) = self.own.shape, self.shared.shape
        matrix = np.zeros((q + s + 1, a + b + 1))
        matrix[:q, :a], matrix[:q, a : a + b] = self.own, -self.leak @ self.shared
        matrix[q : q + s, a : a + b] = self.shared
        matrix[-1, -1] = 1.0
        return matrix


@dataclass(frozen=True, eq=False)
class _Eliminated:
    """One run with its own unknowns eliminated, per combination (...)."""

    inverse: Array  # (..., q', q') of the normal matrix of its own unknowns
    cross: Array  # (..., q', s' + 1) with the shared unknowns and the residual
    left: Array  # (..., s' + 1, s' + 1) Schur complement: shared unknowns and residual
    log_determinant: Array  # (...)


def posterior(
    pieces: Sequence[Piece],
    prior: tuple[Array, Array],
    ratios: Array | None = None,
    with_own: bool = True,
) -> Posterior:
    """Weights of all combinations by restricted likelihood, and the unknowns averaged over them.

    prior: rows (k, s) of priors on shared unknowns and their residuals (k,). ratios (r,): log standard
    deviation of the second channel relative to the first; None: a grid around that of the residuals.
    with_own: False where only the shared unknowns are needed.
    """
    bases = _bases(pieces)
    products = [_products(piece, basis) for piece, basis in zip(pieces, bases, strict=True)]
    counts = [
        sum(int(np.isfinite(piece.residual[:, c]).sum()) for piece in pieces if c in piece.families)
        for c in range(2)
    ]
    whole: list[Array] = [sum((one[c][:, -1, -1] for one in products), np.zeros(1)) for c in range(2)]
    if ratios is None:
        ratios = _ratios(whole, counts, len(pieces))
    scale = np.exp(-2.0 * ratios)
    squares = whole[0][:, None, None] + whole[1][None, :, None] * scale
    rough = float(squares.min()) / sum(counts)  # [rad^2/s^2] by which priors are weighted
    runs = []
    for piece, basis, (first, second) in zip(pieces, bases, products, strict=True):
        grams = first[:, None, None] + second[None, :, None] * scale[:, None, None]
        rows, off = piece.prior
        grams = grams + rough * _gram(rows, np.zeros((len(off), len(basis.shared))), off, basis)
        runs.append(_eliminate(grams, basis.own.shape[1]))
    rows, off = prior
    count = bases[0].own.shape[1]
    known = _gram(np.zeros((len(off), len(bases[0].own))), rows, off, bases[0])[count:, count:]
    left = sum(run.left for run in runs) + rough * known
    return _average(pieces, bases, runs, left, ratios, counts, with_own)


def orthogonal(jacobian: Array) -> Array:
    """Matrix (p, k) that transforms derivatives (m, p) to orthonormal columns (m, k).

    Normal equations in that basis are well conditioned. Directions without information are left out.
    """
    if not jacobian.shape[1]:
        return np.empty((0, 0))
    scale = np.linalg.norm(jacobian, axis=0)
    scale[scale == 0.0] = 1.0
    _, singular, rows = np.linalg.svd(jacobian / scale, full_matrices=False)
    kept = singular > SMALLEST_SINGULAR_VALUE * singular[:1]
    basis: Array = rows[kept].T / singular[kept] / scale[:, None]
    return basis


def _average(
    pieces: Sequence[Piece],
    bases: list[_Basis],
    runs: list[_Eliminated],
    left: Array,
    ratios: Array,
    counts: list[int],
    with_own: bool,
) -> Posterior:
    """Mixture of the unknowns' distributions, weighted by restricted likelihood."""
    size = left.shape[-1] - 1
    scale = np.sqrt(np.diagonal(left, axis1=-2, axis2=-1).max(axis=(0, 1, 2))[:size])
    scale[scale == 0.0] = 1.0
    # A direction with information only in a channel of no weight stays finite by ROUNDING.
    normal = left[..., :size, :size] / np.outer(scale, scale) + ROUNDING * np.eye(size)
    inverse = np.linalg.inv(normal)
    cross = left[..., :size, size] / scale
    steps = np.einsum("...ij,...j->...i", inverse, cross)
    whole = left[..., size, size]
    squares = whole - np.einsum("...i,...i->...", steps, cross)
    squares = np.maximum(squares, ROUNDING * whole)  # without noise the difference is rounding
    degrees = sum(counts) - size - sum(basis.own.shape[1] for basis in bases)
    logs = -0.5 * degrees * np.log(squares) - 0.5 * np.linalg.slogdet(normal)[1] - counts[1] * ratios
    for piece, run in zip(pieces, runs, strict=True):
        logs = logs - 0.5 * run.log_determinant
        for c, family in piece.families.items():
            logs = logs - 0.5 * family.log_determinants.reshape((-1, 1, 1) if c == 0 else (1, -1, 1))
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    variances = squares / degrees
    turn, covariances = bases[0].shared / scale, variances[..., None, None] * inverse
    shift, covariance = _mixed(weights, steps, covariances)
    own = _own(bases, runs, weights, variances, scale, steps, covariances) if with_own else []
    return Posterior(
        weights=weights,
        variances=variances,
        ratios=ratios,
        shift=turn @ shift,
        covariance=turn @ covariance @ turn.T,
        own_shift=tuple(one for one, _ in own),
        own_covariance=tuple(one for _, one in own),
    )


def _own(
    bases: list[_Basis],
    runs: list[_Eliminated],
    weights: Array,
    variances: Array,
    scale: Array,
    steps: Array,
    covariances: Array,
) -> list[tuple[Array, Array]]:
    """Mean change (q,) and covariance (q, q) of each run's own unknowns.

    steps (..., s') and covariances (..., s', s') of the shared ones, times scale (s',).
    """
    found, size = [], steps.shape[-1]
    for basis, run in zip(bases, runs, strict=True):
        out, back = run.cross[..., :size], run.cross[..., size]
        leak = (basis.own @ run.inverse @ out + basis.leak @ basis.shared) / scale
        own_steps = np.einsum("...ij,...j->...i", basis.own @ run.inverse, back)
        own_steps = own_steps - np.einsum("...ij,...j->...i", leak, steps)
        spread = variances[..., None, None] * (basis.own @ run.inverse @ basis.own.T)
        found.append(_mixed(weights, own_steps, spread + leak @ covariances @ np.swapaxes(leak, -1, -2)))
    return found


def _mixed(weights: Array, means: Array, covariances: Array) -> tuple[Array, Array]:
    """Mean (p,) and covariance (p, p) of a mixture of normal distributions (g, h, r)."""
    mean = np.einsum("ghr,ghri->i", weights, means)
    off = means - mean
    spread = np.einsum("ghr,ghri,ghrj->ij", weights, off, off)
    spread += np.einsum("ghr,ghrij->ij", weights, covariances)
    return mean, spread


def _eliminate(grams: Array, count: int) -> _Eliminated:
    """Products (..., d, d) of a run with its first `count` unknowns eliminated."""
    if not count:
        shape = grams.shape[:-2]
        return _Eliminated(np.empty((*shape, 0, 0)), grams[..., :0, :], grams, np.zeros(shape))
    normal = grams[..., :count, :count] + ROUNDING * np.eye(count)
    inverse: Array = np.asarray(np.linalg.inv(normal), dtype=float)
    cross = grams[..., :count, count:]
    left = grams[..., count:, count:] - np.swapaxes(cross, -1, -2) @ inverse @ cross
    determinant: Array = np.asarray(np.linalg.slogdet(normal)[1], dtype=float)
    return _Eliminated(inverse, cross, left, determinant)


def _products(piece: Piece, basis: _Basis) -> list[Array]:
    """Products (g, d, d) of whitened values by channel; zero (1, d, d) for an unmeasured channel."""
    values = np.concatenate([piece.own, piece.shared, piece.residual[:, :, None]], axis=2) @ basis.matrix
    good = np.isfinite(piece.residual)
    size = values.shape[2]
    return [
        piece.families[c].products(values[good[:, c], c])
        if c in piece.families
        else np.zeros((1, size, size))
        for c in range(2)
    ]


def _gram(own: Array, shared: Array, off: Array, basis: _Basis) -> Array:
    """Gram matrix (d, d) of prior rows in a basis."""
    rows = np.concatenate([own, shared, off[:, None]], axis=1) @ basis.matrix
    gram: Array = rows.T @ rows
    return gram


def _bases(pieces: Sequence[Piece]) -> list[_Basis]:
    """Basis of each run; that of the shared unknowns is common."""
    owns, leaks, projected = [], [], []
    for piece in pieces:
        good = np.isfinite(piece.residual)
        good[:, [c for c in range(2) if c not in piece.families]] = False
        own, shared = piece.own[good], piece.shared[good]
        turn = orthogonal(own)
        leak = turn @ (turn.T @ (own.T @ shared))
        owns.append(turn)
        leaks.append(leak)
        projected.append(shared - own @ leak)
    common = orthogonal(np.concatenate(projected))
    return [_Basis(turn, leak, common) for turn, leak in zip(owns, leaks, strict=True)]


def _ratios(whole: list[Array], counts: list[int], run_count: int) -> Array:
    """Grid (r,) of log ratios around that of the residuals, as wide as one run requires."""
    if not (counts[0] and counts[1]):
        return np.zeros(1)
    least = [float(one.min()) / count for one, count in zip(whole, counts, strict=True)]
    std = float(np.sqrt(0.5 * run_count / counts[0] + 0.5 * run_count / counts[1]))
    found: Array = 0.5 * np.log(max(least[1], 1e-300) / max(least[0], 1e-300)) + std * RATIO_STEPS
    return found
