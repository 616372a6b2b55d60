"""Sandwich (robust) covariance of least-squares estimates under autoregressive noise.

    cov b = (J'J)^-1 J' V J (J'J)^-1,   V averaged over the posterior of the noise

Reference: P. J. Huber, Proc. Fifth Berkeley Symp. Math. Stat. Prob. 1 (1967) 221-233, for the form.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from tms_fit.noise.ar import ARFamily
from tms_fit.noise.ar_process import autocovariances
from tms_fit.noise.posterior import Piece, Posterior
from tms_model.bicycle import Array

from tms_calibrate.pooled_problem import PooledSolution
from tms_calibrate.pooled_solver import Linearised


def sandwich_covariance(
    solution: PooledSolution, runs: Sequence[Linearised], pieces: Sequence[Piece], found: Posterior
) -> tuple[Array, tuple[Array, ...]]:
    """Covariances (s, s) of shared values and (q, q) of each run's own, without priors."""
    assert solution.arrow is not None
    inverse = solution.arrow.shared_inverse / solution.problem.noise**2
    lags = _mean_autocovariances(pieces, found)
    parts = [_influence(run, piece, lags) for run, piece in zip(runs, pieces, strict=True)]
    shared = inverse @ sum((meat for _, _, meat, _ in parts), np.zeros(inverse.shape)) @ inverse
    own = []
    for alone, leak, _, cross in parts:
        both = cross @ inverse @ leak.T
        own.append(alone + leak @ shared @ leak.T - both - both.T)
    return shared, tuple(own)


def _influence(run: Linearised, piece: Piece, lags: dict[int, Array]) -> tuple[Array, Array, Array, Array]:
    """E V E' (q, q), E S (q, s), P' V P (s, s) and E V P (q, s) of one run.

    E (q, m) is the pseudoinverse of the run's own columns, P (m, s) is S projected orthogonally to them.
    """
    good = np.isfinite(run.residual)
    own, shared = run.own[good], run.shared[good]
    error = np.linalg.pinv(own)
    projected = shared - own @ (error @ shared)
    rows, channels = np.nonzero(good)
    covariance = np.zeros((len(rows), len(rows)))
    for c, family in piece.families.items():
        assert isinstance(family, ARFamily)
        here = channels == c
        places = family.members[0].places
        covariance[np.ix_(here, here)] = lags[c][np.abs(places[:, None] - places)]
    spread = covariance @ projected
    return error @ covariance @ error.T, error @ shared, projected.T @ spread, error @ spread


def _mean_autocovariances(pieces: Sequence[Piece], found: Posterior) -> dict[int, Array]:
    """Autocovariances (lags,) [rad^2/s^2] of each channel, averaged over the posterior."""
    averages = {}
    for c in {c for piece in pieces for c in piece.families}:
        families = [piece.families[c] for piece in pieces if c in piece.families]
        members = [one.members for one in families if isinstance(one, ARFamily)]
        longest = max(one[0].count for one in members)
        sizes = found.weights * found.variances * np.exp(2.0 * c * found.ratios)
        sizes = sizes.sum(axis=(1 - c, 2))
        each = autocovariances([one.process for one in members[0]], longest)
        averages[c] = sizes @ each
    return averages
