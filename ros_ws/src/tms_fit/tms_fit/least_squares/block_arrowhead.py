"""Least squares with unknowns of each run and unknowns that all runs share: the arrow-shaped problem.

    minimise  sum_i | r_i - O_i a_i - S_i b |^2 + | p - P b |^2

The unknowns a_i of a run are projected out of its rows by a QR decomposition; what is left tells b, and b
tells the a_i. Cost and memory grow with the number of runs, not with its square.

Reference: A. Bjorck, Numerical Methods for Least Squares Problems (1996), section 6.3 (block angular form).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from tms_model.bicycle import Array

RANK = 1e-9  # smallest singular value of scaled columns, per largest, that still tells unknowns apart


@dataclass(frozen=True, eq=False)
class Block:
    """Rows of one run."""

    own: Array  # O (m, q)
    shared: Array  # S (m, s)
    target: Array  # r (m,)


@dataclass(frozen=True, eq=False)
class BlockArrowheadSolution:
    """Best values, and their covariance per unit variance of the rows."""

    own: tuple[Array, ...]  # (q,) of each run
    shared: Array  # (s,)
    residuals: tuple[Array, ...]  # (m,) of each run
    own_inverse: tuple[Array, ...]  # (q, q) of each run
    shared_inverse: Array  # (s, s)
    projected: tuple[Array, ...]  # (m, s): S with what the run's own unknowns can imitate taken out


def solve_block_arrowhead(
    blocks: Sequence[Block], prior: Array, prior_target: Array
) -> BlockArrowheadSolution | None:
    """The solution, or None where a run's rows don't tell its own unknowns apart, or all rows b.

    prior: P (k, s), prior_target: p (k,); (0, s) and (0,) for none.
    """
    factors = [_factors(block.own) for block in blocks]
    if any(factor is None for factor in factors):
        return None
    known = [factor for factor in factors if factor is not None]
    projected = tuple(b.shared - q @ (q.T @ b.shared) for b, (q, _) in zip(blocks, known, strict=True))
    left = [b.target - q @ (q.T @ b.target) for b, (q, _) in zip(blocks, known, strict=True)]
    found = _least_squares(np.concatenate([*projected, prior]), np.concatenate([*left, prior_target]))
    if found is None:
        return None
    shared, shared_inverse = found
    residuals = tuple(r - p @ shared for r, p in zip(left, projected, strict=True))
    own, inverses = [], []
    for block, (q, upper_inverse) in zip(blocks, known, strict=True):
        own.append(upper_inverse @ (q.T @ (block.target - block.shared @ shared)))
        leak = upper_inverse @ (q.T @ block.shared)  # of an error of b into the run's own
        inverses.append(upper_inverse @ upper_inverse.T + leak @ shared_inverse @ leak.T)
    return BlockArrowheadSolution(tuple(own), shared, residuals, tuple(inverses), shared_inverse, projected)


def _factors(matrix: Array) -> tuple[Array, Array] | None:
    """Q (m, q) and the inverse of R (q, q), or None if the columns are not independent."""
    if not matrix.shape[1]:
        return np.empty((len(matrix), 0)), np.empty((0, 0))
    scale = np.linalg.norm(matrix, axis=0)
    if len(matrix) < matrix.shape[1] or not (np.isfinite(scale).all() and scale.all()):
        return None
    q, upper = np.linalg.qr(matrix / scale)
    if np.linalg.cond(upper) > 1.0 / RANK:
        return None
    return q, np.linalg.inv(upper) / scale[:, None]


def _least_squares(matrix: Array, target: Array) -> tuple[Array, Array] | None:
    """Solution (s,) and inverse of the normal matrix (s, s), or None if the columns are not independent."""
    factors = _factors(matrix)
    if factors is None:
        return None
    q, upper_inverse = factors
    return upper_inverse @ (q.T @ target), upper_inverse @ upper_inverse.T
