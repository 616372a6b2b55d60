"""Block-arrowhead linear least squares: unknowns of each block and unknowns shared by all blocks.

    minimise  sum_i | r_i - O_i a_i - S_i b |^2 + | p - P b |^2

The unknowns a_i of a block are projected out of its rows by a QR decomposition; the projected rows determine
b, and b determines the a_i. Cost and memory grow with the number of blocks, not with its square.

Reference: A. Bjorck, Numerical Methods for Least Squares Problems (1996), section 6.3 (block angular form).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from tms_model.bicycle import Array

SMALLEST_SINGULAR_VALUE = 1e-9  # of scaled columns, relative to the largest, for independent columns


@dataclass(frozen=True, eq=False)
class Block:
    """Rows of one block: Jacobian by own and shared unknowns, and target."""

    own: Array  # O (m, q)
    shared: Array  # S (m, s)
    target: Array  # r (m,)

    def with_rows(self, own: Array, target: Array) -> Block:
        """Block with further rows (k, q) and targets (k,) that depend on its own unknowns only."""
        if not len(target):
            return self
        return Block(
            np.concatenate([self.own, own]),
            np.concatenate([self.shared, np.zeros((len(target), self.shared.shape[1]))]),
            np.concatenate([self.target, target]),
        )


@dataclass(frozen=True, eq=False)
class BlockArrowheadSolution:
    """Least-squares values, and their covariance per unit variance of the rows."""

    own: tuple[Array, ...]  # (q,) of each block
    shared: Array  # (s,)
    residuals: tuple[Array, ...]  # (m,) of each block
    own_inverse: tuple[Array, ...]  # (q, q) of each block
    shared_inverse: Array  # (s, s)
    projected: tuple[Array, ...]  # (m, s): S orthogonal to the block's own columns


@dataclass(frozen=True, eq=False)
class BlockArrowhead:
    """QR factors of the columns of all blocks and of the prior rows P (k, s)."""

    own: tuple[tuple[Array, Array], ...]  # Q (m, q) and the inverse of R (q, q) of each block
    shared: tuple[Array, Array]  # the same of all projected rows, those of P last
    projected: tuple[Array, ...]  # (m, s) of each block

    def residuals(self, targets: Sequence[Array], prior_target: Array) -> list[Array]:
        """Least-squares residuals of targets (m, ...) of each block, then of the prior's (k, ...)."""
        q, _ = self.shared
        left = [r - own @ (own.T @ r) for r, (own, _) in zip(targets, self.own, strict=True)]
        whole = np.concatenate([*left, prior_target])
        whole = whole - q @ (q.T @ whole)
        return np.split(whole, np.cumsum([len(one) for one in left]))

    def solve(self, blocks: Sequence[Block], prior_target: Array) -> BlockArrowheadSolution:
        """Solution for the blocks whose columns were factorized; prior_target: p (k,)."""
        left = [b.target - q @ (q.T @ b.target) for b, (q, _) in zip(blocks, self.own, strict=True)]
        shared_q, shared_r = self.shared
        shared = shared_r @ (shared_q.T @ np.concatenate([*left, prior_target]))
        shared_inverse = shared_r @ shared_r.T
        residuals = tuple(r - p @ shared for r, p in zip(left, self.projected, strict=True))
        own, inverses = [], []
        for block, (q, upper_inverse) in zip(blocks, self.own, strict=True):
            own.append(upper_inverse @ (q.T @ (block.target - block.shared @ shared)))
            leak = upper_inverse @ (q.T @ block.shared)  # of an error of b into the block's own unknowns
            inverses.append(upper_inverse @ upper_inverse.T + leak @ shared_inverse @ leak.T)
        return BlockArrowheadSolution(
            tuple(own), shared, residuals, tuple(inverses), shared_inverse, self.projected
        )


def factorize(
    blocks: Sequence[Block], prior: Array, smallest: float = SMALLEST_SINGULAR_VALUE
) -> BlockArrowhead | None:
    """QR factors, or None where columns are not independent.

    prior: P (k, s), (0, s) for none. smallest: least singular value of independent columns, relative to the
    largest.
    """
    own = []
    for block in blocks:
        factors = _factors(block.own, smallest)
        if factors is None:
            return None
        own.append(factors)
    if not prior.shape[1]:
        rows = sum(len(block.target) for block in blocks) + len(prior)
        nothing = np.empty((rows, 0)), np.empty((0, 0))
        return BlockArrowhead(tuple(own), nothing, tuple(block.shared for block in blocks))
    projected = tuple(b.shared - q @ (q.T @ b.shared) for b, (q, _) in zip(blocks, own, strict=True))
    shared = _factors(np.concatenate([*projected, prior]), smallest)
    return None if shared is None else BlockArrowhead(tuple(own), shared, projected)


def solve_block_arrowhead(
    blocks: Sequence[Block],
    prior: Array,
    prior_target: Array,
    smallest: float = SMALLEST_SINGULAR_VALUE,
) -> BlockArrowheadSolution | None:
    """Least-squares solution, or None where a block's rows do not determine its own unknowns, or all rows b.

    prior: P (k, s), prior_target: p (k,); (0, s) and (0,) for none. smallest: as for `factorize`.
    """
    factors = factorize(blocks, prior, smallest)
    return None if factors is None else factors.solve(blocks, prior_target)


def _factors(matrix: Array, smallest: float) -> tuple[Array, Array] | None:
    """Q (m, q) and the inverse of R (q, q), or None if the columns are not independent."""
    if not matrix.shape[1]:
        return np.empty((len(matrix), 0)), np.empty((0, 0))
    scale = np.linalg.norm(matrix, axis=0)
    if len(matrix) < matrix.shape[1] or not (np.isfinite(scale).all() and scale.all()):
        return None
    q, upper = np.linalg.qr(matrix / scale)
    singular = np.linalg.svd(upper, compute_uv=False)
    if not singular[-1] > smallest * singular[0]:
        return None
    return q, np.linalg.inv(upper) / scale[:, None]
