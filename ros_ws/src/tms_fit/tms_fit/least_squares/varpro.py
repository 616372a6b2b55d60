"""Variable projection: separable nonlinear least squares in residual blocks.

    minimise  sum_i | t_i(x_i, y) - O_i(x_i, y) a_i - S_i(x_i, y) b |^2 + priors

Block i has linear unknowns a_i and nonlinear unknowns x_i of its own; b and y are linear and nonlinear
unknowns shared by all blocks. At given x_i and y the best a_i and b follow by block-arrowhead least squares.
`scipy.optimize.least_squares` minimises over x_i and y, with Kaufman's form of the Jacobian of the projected
residual. Without nonlinear unknowns the problem is solved in one step. A fit of one run is one block.

References: G. H. Golub and V. Pereyra, SIAM J. Numer. Anal. 10 (1973), doi 10.1137/0710036; L. Kaufman, BIT
15 (1975), doi 10.1007/BF01932995.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from tms_model import ParameterError
from tms_model.bicycle import Array

from tms_fit.least_squares.block_arrowhead import (
    SMALLEST_SINGULAR_VALUE,
    Block,
    BlockArrowhead,
    BlockArrowheadSolution,
    factorize,
    solve_block_arrowhead,
)

MAX_EVALUATIONS = 50  # of the residuals
TOLERANCE = 1e-6  # last step, in standard errors
ROUNDING = 1e-11  # of a nonlinear value, below which a step has no true digits
FIRST_STEP = 1e4  # standard errors that the first step may take
GRADIENT_ROUNDING = 1e-15  # gradient of a problem scaled to standard errors that counts as zero


class Status(str, Enum):
    """Outcome of a solver."""

    OK = "ok"
    NOT_CONVERGED = "not_converged"
    NOT_OBSERVABLE = "not_observable"


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Linear, then nonlinear unknowns, with bounds and Gaussian priors."""

    linear: int  # number of linear unknowns
    start: Array  # (k,) first values of the nonlinear unknowns
    low: Array  # (k,) least values of the nonlinear unknowns
    high: Array  # (k,) largest values
    prior_mean: Array  # (p,) of all unknowns, p = linear + k
    prior_std: Array  # (p,), infinite where there is no prior

    def prior_rows(self, columns: slice) -> tuple[Array, Array]:
        """Rows (m, q) that priors on some unknowns add, and their targets (m,): measurements of them."""
        mean, std = self.prior_mean[columns], self.prior_std[columns]
        index = np.isfinite(std).nonzero()[0]
        if not len(index):
            return np.empty((0, len(std))), np.empty(0)
        rows = np.zeros((len(index), len(std)))
        rows[np.arange(len(index)), index] = 1.0 / std[index]
        return rows, mean[index] / std[index]


@dataclass(frozen=True, eq=False)
class ResidualBlock:
    """One group of residual rows with its own unknowns.

    linear(nonlinear) returns the columns of the linear unknowns, own and shared, and the target t;
    slopes(nonlinear, linear) returns the derivatives of the prediction by the nonlinear unknowns, own (m, k)
    and shared (m, l). Values are those of the own unknowns, then of the shared ones.
    """

    own: Unknowns
    linear: Callable[[Array], Block]
    slopes: Callable[[Array, Array], tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class Solution:
    """Outcome of `solve`; without values where the data do not determine the unknowns."""

    status: Status
    own: tuple[Array, ...] = ()  # (p,) of each block: linear, then nonlinear
    shared: Array = field(default_factory=lambda: np.empty(0))  # (s,) the same
    blocks: tuple[Block, ...] = ()  # linearised at the solution; targets are residuals, rows of priors last
    arrow: BlockArrowheadSolution | None = None  # of these blocks: a Gauss-Newton step, covariances
    evaluations: int = 0


@dataclass(frozen=True, eq=False)
class _Point:
    """The problem at one set of nonlinear values, solved for the linear ones."""

    problem: _Minimiser
    nonlinear: Array  # (x,) of all blocks, then shared
    blocks: tuple[Block, ...]  # of the linear unknowns, rows of their priors last
    factors: BlockArrowhead
    found: BlockArrowheadSolution
    residual: Array  # (m,) all rows, those of priors on nonlinear unknowns last

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.residual @ self.residual)

    @cached_property
    def slopes(self) -> list[tuple[Array, Array]]:
        """Derivatives of each block's prediction by its own and by shared nonlinear unknowns."""
        own, common = self.problem.split(self.nonlinear)
        return [
            block.slopes(np.concatenate([values, common]), np.concatenate([linear, self.found.shared]))
            for block, values, linear in zip(self.problem.blocks, own, self.found.own, strict=True)
        ]


def solve(
    blocks: Sequence[ResidualBlock],
    shared: Unknowns,
    tolerance: float = TOLERANCE,
    smallest: float = SMALLEST_SINGULAR_VALUE,
) -> Solution:
    """Minimum of the sum of squares.

    tolerance: last step, in standard errors. smallest: least singular value of the scaled Jacobian of
    observable unknowns, relative to the largest. Raises ParameterError if the residuals can't be evaluated at
    the first values.
    """
    minimiser = _Minimiser(blocks, shared)
    point = minimiser.at(minimiser.start)
    first = minimiser.solution(point, smallest)
    if point is None or first.arrow is None or not minimiser.free.any():
        return first
    point, converged, evaluations = minimiser.minimise(point, tolerance)
    status = Status.OK if converged else Status.NOT_CONVERGED
    return minimiser.solution(point, smallest, status, evaluations)


def linearise(
    blocks: Sequence[ResidualBlock], shared: Unknowns, smallest: float = SMALLEST_SINGULAR_VALUE
) -> Solution:
    """Solution for the linear unknowns at the first nonlinear values. Raises as `solve` does."""
    minimiser = _Minimiser(blocks, shared)
    return minimiser.solution(minimiser.at(minimiser.start), smallest)


def cost(blocks: Sequence[ResidualBlock], shared: Unknowns) -> float:
    """Sum of squares at the first nonlinear values; infinite where it can't be evaluated."""
    minimiser = _Minimiser(blocks, shared)
    try:
        point = minimiser.at(minimiser.start)
    except ParameterError:
        return math.inf
    return math.inf if point is None else point.cost


class _Minimiser:
    """The projected problem as a function of the nonlinear unknowns: own ones of each block, then shared."""

    def __init__(self, blocks: Sequence[ResidualBlock], shared: Unknowns) -> None:
        self.blocks, self.shared = blocks, shared
        every = [*(block.own for block in blocks), shared]
        self.counts = [len(one.start) for one in every]
        self.low = np.concatenate([one.low for one in every])
        self.high = np.concatenate([one.high for one in every])
        self.start = np.clip(np.concatenate([one.start for one in every]), self.low, self.high)
        self.free: NDArray[np.bool_] = self.high > self.low
        self.prior_rows, self.prior_target = np.empty((0, len(self.start))), np.empty(0)
        if not len(self.start):
            return
        priors = [one.prior_rows(slice(one.linear, None)) for one in every]
        self.prior_rows = np.zeros((sum(len(rows) for rows, _ in priors), len(self.start)))
        self.prior_target = np.concatenate([target for _, target in priors])
        row = column = 0
        for (rows, _), count in zip(priors, self.counts, strict=True):
            self.prior_rows[row : row + len(rows), column : column + count] = rows
            row, column = row + len(rows), column + count

    def split(self, nonlinear: Array) -> tuple[list[Array], Array]:
        """Nonlinear values of each block, and shared ones."""
        if not len(nonlinear):
            return [nonlinear] * len(self.blocks), nonlinear
        *own, shared = np.split(nonlinear, np.cumsum(self.counts)[:-1])
        return own, shared

    def at(self, nonlinear: Array) -> _Point | None:
        """Best linear values at given nonlinear ones; None if the rows do not determine them."""
        own, common = self.split(nonlinear)
        rows = []
        for block, values in zip(self.blocks, own, strict=True):
            prior, wanted = block.own.prior_rows(slice(block.own.linear))
            rows.append(block.linear(np.concatenate([values, common])).with_rows(prior, wanted))
        prior, wanted = self.shared.prior_rows(slice(self.shared.linear))
        factors = factorize(rows, prior)
        if factors is None:
            return None
        found = factors.solve(rows, wanted)
        off = [wanted - prior @ found.shared, self.prior_target - self.prior_rows @ nonlinear]
        residual = np.concatenate([*found.residuals, *off])
        return _Point(self, nonlinear, tuple(rows), factors, found, residual)

    def projected_jacobian(self, point: _Point) -> Array:
        """Derivative (m, x) of the projected residual, without the term in the columns' own derivatives."""
        columns, first = [], 0
        for rows, (own, common), count in zip(point.blocks, point.slopes, self.counts[:-1], strict=True):
            whole = np.zeros((len(rows.target), len(self.start)))
            whole[: len(own), first : first + count] = own
            whole[: len(common), len(self.start) - self.counts[-1] :] = common
            columns.append(whole)
            first += count
        prior = np.zeros((len(point.factors.shared[0]) - sum(len(one) for one in columns), len(self.start)))
        projected = point.factors.residuals(columns, prior)
        jacobian: Array = -np.concatenate([*projected, self.prior_rows])
        return jacobian

    def solution(
        self, point: _Point | None, smallest: float, status: Status = Status.OK, evaluations: int = 1
    ) -> Solution:
        """Solution at a point; not observable where the unknowns' columns are not independent there."""
        if point is None:
            return Solution(Status.NOT_OBSERVABLE)
        if not len(self.start):
            found = point.found
            blocks = tuple(replace(b, target=r) for b, r in zip(point.blocks, found.residuals, strict=True))
            return Solution(status, found.own, found.shared, blocks, found, evaluations)
        own, common = self.split(point.nonlinear)
        prior, wanted = self.shared.prior_rows(slice(None))
        shared = np.concatenate([point.found.shared, common])
        blocks = tuple(self._linearised(point, k, values) for k, values in enumerate(own))
        arrow = solve_block_arrowhead(blocks, prior, wanted - prior @ shared, smallest)
        if arrow is None:
            return Solution(Status.NOT_OBSERVABLE)
        values = tuple(np.concatenate(pair) for pair in zip(point.found.own, own, strict=True))
        return Solution(status, values, shared, blocks, arrow, evaluations)

    def _linearised(self, point: _Point, k: int, nonlinear: Array) -> Block:
        """Rows of one block for all its unknowns around a point, those of priors on nonlinear ones last."""
        own, rows, slopes = self.blocks[k].own, point.blocks[k], point.slopes[k]
        extra = len(rows.target) - len(slopes[0])  # rows of priors on linear unknowns
        by_own, by_shared = (np.concatenate([one, np.zeros((extra, one.shape[1]))]) for one in slopes)
        whole = Block(
            np.concatenate([rows.own, by_own], axis=1),
            np.concatenate([rows.shared, by_shared], axis=1),
            point.found.residuals[k],
        )
        prior, wanted = own.prior_rows(slice(own.linear, None))
        on_linear = np.zeros((len(prior), own.linear))
        return whole.with_rows(np.concatenate([on_linear, prior], axis=1), wanted - prior @ nonlinear)

    def minimise(self, point: _Point, tolerance: float) -> tuple[_Point, bool, int]:
        """Best point, whether it is a minimum, and the number of evaluations.

        scipy minimises over values z per standard error, which start at FIRST_STEP: its first trust region is
        as large as its first values, and its tolerance is relative to them.
        """
        from scipy.optimize import least_squares  # 0.2 s to import

        start, first = point.nonlinear, self.projected_jacobian(point)
        spread = math.sqrt(point.cost / max(len(point.residual) - len(start), 1)) or 1.0
        size = np.linalg.norm(first[:, self.free], axis=0)
        std = spread / np.where(size > 0.0, size, np.inf)
        scale = std + ROUNDING * (1.0 + np.abs(start[self.free])) / tolerance
        points = {start.tobytes(): point}
        best = point

        low, high = ((end - start)[self.free] / scale + FIRST_STEP for end in (self.low, self.high))

        def values(z: Array) -> Array:
            moved = start.copy()
            # A value at a bound is that bound to the last digit.
            inside = np.where(z <= low, self.low[self.free], start[self.free] + scale * (z - FIRST_STEP))
            moved[self.free] = np.where(z >= high, self.high[self.free], inside)
            return moved

        def residual(z: Array) -> Array:
            moved = values(z)
            key = moved.tobytes()
            if key not in points:
                try:
                    trial = self.at(moved)
                except ParameterError:  # such as a speed that falls below zero within the window
                    trial = None
                if trial is None:
                    return np.full(len(point.residual), np.inf)
                points[key] = trial
            return points[key].residual / spread

        def jacobian(z: Array) -> Array:
            nonlocal best
            best = points[values(z).tobytes()]
            points.clear()
            points[best.nonlinear.tobytes()] = best
            by_values = first if best is point else self.projected_jacobian(best)
            scaled: Array = by_values[:, self.free] * (scale / spread)
            return scaled

        found = least_squares(
            residual,
            np.full(len(scale), FIRST_STEP),
            jacobian,
            bounds=(low, high),
            method="dogbox",
            ftol=None,
            xtol=tolerance / FIRST_STEP,
            gtol=GRADIENT_ROUNDING,
            max_nfev=MAX_EVALUATIONS,
        )
        return best, found.status > 0, int(found.nfev)
