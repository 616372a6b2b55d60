"""Unknowns of several runs averaged over what their noise may be: one law for all runs.

As in `tms_fit.noise.posterior`, each combination of candidates for the two channels, and of
ratios between the channels' deviations, has the weight of its restricted likelihood, now over all runs. The
unknowns of a run are projected out of its rows for each combination (the arrow's block elimination), so that
cost grows with the number of runs, not with its square.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from tms_fit.noise.posterior import CANCELLED, RATIOS, Family, orthogonal
from tms_model.bicycle import Array


@dataclass(frozen=True, eq=False)
class Piece:
    """A run around its solution, and what its samples' noise may be."""

    families: Mapping[int, Family]  # of each channel that was measured, the same candidates in all runs
    own: Array  # (n, 2, q) derivatives by its own unknowns
    shared: Array  # (n, 2, s)
    residual: Array  # (n, 2) [rad/s], NaN: not measured
    prior: tuple[Array, Array]  # rows (k, q) of priors on its own unknowns, and how far (k,) they are off


@dataclass(frozen=True, eq=False)
class Posterior:
    """Weights of all combinations (g, h, r), and what each makes of the unknowns."""

    weights: Array  # (g, h, r) candidates of the first channel, of the second, ratios
    variances: Array  # (g, h, r) [rad^2/s^2] of the first channel's innovations
    ratios: Array  # (r,) logarithms of the second channel's deviation per the first's
    shift: Array  # (s,) mean change of the shared unknowns
    covariance: Array  # (s, s)
    own_shift: tuple[Array, ...]  # (q,) of each run
    own_covariance: tuple[Array, ...]  # (q, q)

    @property
    def best(self) -> tuple[int, int, int]:
        """The likeliest combination."""
        first, second, ratio = np.unravel_index(int(self.weights.argmax()), self.weights.shape)
        return int(first), int(second), int(ratio)


@dataclass(frozen=True, eq=False)
class _Basis:
    """Unknowns of a run with orthonormal derivatives, and shared ones without what those imitate."""

    own: Array  # T (q, q')
    leak: Array  # K (q, s) of the shared unknowns into the run's own
    shared: Array  # W (s, s')

    @property
    def matrix(self) -> Array:
        """(q + s + 1, q' + s' + 1) for derivatives by own and shared unknowns and the residual."""
        (q, a), (s, b) = self.own.shape, self.shared.shape
        matrix = np.zeros((q + s + 1, a + b + 1))
        matrix[:q, :a], matrix[:q, a : a + b] = self.own, -self.leak @ self.shared
        matrix[q : q + s, a : a + b] = self.shared
        matrix[-1, -1] = 1.0
        return matrix


@dataclass(frozen=True, eq=False)
class _Eliminated:
    """One run with its own unknowns solved for, per combination (...)."""

    inverse: Array  # (..., q', q') of the normal matrix of its own unknowns
    cross: Array  # (..., q', s' + 1) with the shared unknowns and the residual
    left: Array  # (..., s' + 1, s' + 1) normal matrix of what is left
    log_determinant: Array  # (...)


def posterior(
    pieces: Sequence[Piece], ratios: Array | None, prior: tuple[Array, Array], with_own: bool = True
) -> Posterior:
    """Weights of all combinations by restricted likelihood, and the unknowns under them.

    ratios: logarithms of the ratios tried; None: around what the residuals show. prior: rows (k, s) on shared
    unknowns and how far (k,) they are off. with_own: False where only the shared unknowns are asked for.
    """
    bases = _bases(pieces)
    products = [_products(piece, basis) for piece, basis in zip(pieces, bases, strict=True)]
    counts = [sum(int(np.isfinite(piece.residual[:, c]).sum()) for piece in pieces) for c in range(2)]
    whole: list[Array] = [sum((one[c][:, -1, -1] for one in products), np.zeros(1)) for c in range(2)]
    if ratios is None:
        ratios = _ratios(whole, counts, len(pieces))
    scale = np.exp(-2.0 * ratios)
    squares = whole[0][:, None, None] + whole[1][None, :, None] * scale
    rough = float(squares.min()) / sum(counts)  # a variance, by which priors are weighed
    runs = []
    for piece, basis, (first, second) in zip(pieces, bases, products, strict=True):
        grams = first[:, None, None] + second[None, :, None] * scale[:, None, None]
        rows, off = piece.prior
        grams = grams + rough * _gram(rows, np.zeros((len(off), len(basis.shared))), off, basis)
        runs.append(_eliminate(grams, basis.own.shape[1]))
    rows, off = prior
    left = sum(run.left for run in runs)
    left = (
        left
        + rough
        * _gram(np.zeros((len(off), len(bases[0].own))), rows, off, bases[0])[
            bases[0].own.shape[1] :, bases[0].own.shape[1] :
        ]
    )
    return _average(pieces, bases, runs, left, ratios, counts, with_own)


def _average(
    pieces: Sequence[Piece],
    bases: list[_Basis],
    runs: list[_Eliminated],
    left: Array,
    ratios: Array,
    counts: list[int],
    with_own: bool,
) -> Posterior:
    size = left.shape[-1] - 1
    normal = left[..., :size, :size] + CANCELLED * np.eye(size)
    inverse = np.linalg.inv(normal)
    steps = np.einsum("...ij,...j->...i", inverse, left[..., :size, size])
    squares = left[..., size, size] - np.einsum("...i,...i->...", steps, left[..., :size, size])
    squares = np.maximum(squares, CANCELLED * left[..., size, size])
    degrees = sum(counts) - size - sum(basis.own.shape[1] for basis in bases)
    logs = -0.5 * degrees * np.log(squares) - 0.5 * np.linalg.slogdet(normal)[1] - counts[1] * ratios
    for piece, run in zip(pieces, runs, strict=True):
        logs = logs - 0.5 * run.log_determinant
        for c, family in piece.families.items():
            shape = (-1, 1, 1) if c == 0 else (1, -1, 1)
            logs = logs - 0.5 * family.log_determinants.reshape(shape)
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    variances = squares / degrees
    covariances = variances[..., None, None] * inverse
    shift, covariance = _mixed(weights, steps, covariances)
    own = []
    for basis, run in zip(bases if with_own else [], runs, strict=False):
        out, back = run.cross[..., :size], run.cross[..., size]
        leak = basis.own @ run.inverse @ out + basis.leak @ basis.shared
        own_steps = np.einsum("...ij,...j->...i", basis.own @ run.inverse, back)
        own_steps = own_steps - np.einsum("...ij,...j->...i", leak, steps)
        spread = variances[..., None, None] * (basis.own @ run.inverse @ basis.own.T)
        own.append(_mixed(weights, own_steps, spread + leak @ covariances @ np.swapaxes(leak, -1, -2)))
    turn = bases[0].shared
    return Posterior(
        weights=weights,
        variances=variances,
        ratios=ratios,
        shift=turn @ shift,
        covariance=turn @ covariance @ turn.T,
        own_shift=tuple(one for one, _ in own),
        own_covariance=tuple(one for _, one in own),
    )


def _mixed(weights: Array, means: Array, covariances: Array) -> tuple[Array, Array]:
    """Mean (p,) and covariance (p, p) of a mixture of normal distributions (g, h, r)."""
    mean = np.einsum("ghr,ghri->i", weights, means)
    off = means - mean
    spread = np.einsum("ghr,ghri,ghrj->ij", weights, off, off)
    spread += np.einsum("ghr,ghrij->ij", weights, covariances)
    return mean, spread


def _eliminate(grams: Array, count: int) -> _Eliminated:
    normal = grams[..., :count, :count] + CANCELLED * np.eye(count)
    inverse: Array = np.asarray(np.linalg.inv(normal), dtype=float)
    cross = grams[..., :count, count:]
    left = grams[..., count:, count:] - np.swapaxes(cross, -1, -2) @ inverse @ cross
    determinant: Array = np.asarray(np.linalg.slogdet(normal)[1], dtype=float)
    return _Eliminated(inverse, cross, left, determinant)


def _products(piece: Piece, basis: _Basis) -> list[Array]:
    """Products (g, d, d) of each channel's whitened values; zero (1, d, d) where none was measured."""
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
    """Products (d, d) of prior rows in a basis."""
    rows = np.concatenate([own, shared, off[:, None]], axis=1) @ basis.matrix
    gram: Array = rows.T @ rows
    return gram


def _bases(pieces: Sequence[Piece]) -> list[_Basis]:
    owns, leaks, projected = [], [], []
    for piece in pieces:
        good = np.isfinite(piece.residual)
        own, shared = piece.own[good], piece.shared[good]
        turn = orthogonal(own)
        leak = turn @ (turn.T @ (own.T @ shared))
        owns.append(turn)
        leaks.append(leak)
        projected.append(shared - own @ leak)
    common = orthogonal(np.concatenate(projected))
    return [_Basis(turn, leak, common) for turn, leak in zip(owns, leaks, strict=True)]


def _ratios(whole: list[Array], counts: list[int], run_count: int) -> Array:
    """Around what the residuals show, as wide as one run leaves them."""
    if not (counts[0] and counts[1]):
        return np.zeros(1)
    least = [float(one.min()) / count for one, count in zip(whole, counts, strict=True)]
    std = float(np.sqrt(0.5 * run_count / counts[0] + 0.5 * run_count / counts[1]))
    found: Array = 0.5 * np.log(max(least[1], 1e-300) / max(least[0], 1e-300)) + std * RATIOS
    return found
