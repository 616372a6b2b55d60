"""Predictions of one window tabulated over speed and other nonlinear parameters, to fit many runs at once.

All predictions of a problem, for any parameters within a box, lie in a space of some twenty dimensions. Its
basis comes from the singular values of predictions at Chebyshev's points of the box; the coordinates in it
are Chebyshev series in the parameters. A run's samples enter by one product with the basis; all else happens
in coordinates, whatever the number of samples.

Reference: L. N. Trefethen, Approximation Theory and Approximation Practice (2013), chapters 3 and 8, doi
10.1137/1.9781611975949, for the series and their convergence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebvander
from numpy.typing import NDArray
from tms_model import ParameterError
from tms_model.bicycle import Array

from tms_fit.least_squares.gram import GramSeries, chebyshev_transform, gram_series
from tms_fit.least_squares.varpro import LINEAR_RANK, Problem, full_rank, starting_values
from tms_fit.response.prediction import predictor

FIRST, MOST = 8, 64  # Chebyshev points per parameter, to begin with and at most
TOLERANCE = 1e-9  # of the basis and the series, per largest prediction
THREADLESS = 200_000  # products of numbers for which OpenBLAS starts no threads
CHECKS = 7  # points per parameter between Chebyshev's, at which the error is measured


@dataclass(frozen=True, eq=False)
class Table:
    """Predictions of a problem: rows (m,) = basis @ (coordinates @ linear parameters + those of the forced).

    The rows are the measured samples of the problem's window, both channels, sample by sample.
    """

    problem: Problem
    good: NDArray[np.bool_]  # (n, 2), measured in the problem's window
    low: Array  # (q,) ends of the box
    high: Array
    basis: Array  # (m, r), orthonormal
    series: Array  # (k_1 ... k_q, r (p + 1)) Chebyshev coefficients, flattened to (k_1 ... k_q) by r (p + 1)
    orders: tuple[int, ...]  # k_1 ... k_q
    error: float  # largest seen between Chebyshev's points, per largest prediction

    @cached_property
    def complete(self) -> bool:
        """Whether no sample of the problem's window is missing."""
        return bool(self.good.all())

    @cached_property
    def sample_count(self) -> int:
        """Scalar measurements of a run, m."""
        return int(self.good.sum())

    @cached_property
    def start(self) -> Array:
        """Nonlinear values (q,) as the problem's window knows them."""
        return starting_values(self.problem)

    @property
    def rank(self) -> int:
        """Dimensions of the space, r."""
        return int(self.basis.shape[1])

    @property
    def column_count(self) -> int:
        """Columns of linear parameters and forced response, and their derivatives, c = (1 + q) (p + 1)."""
        return (1 + len(self.orders)) * (len(self.problem.linear) + 1)

    def coordinates(self, nonlinear: Array) -> Array:
        """Coordinates of the linear parameters' columns and of the forced response (R, r, p + 1).

        nonlinear: (R, q), within the box.
        """
        return self.columns(nonlinear)[:, : len(self.problem.linear) + 1].transpose(0, 2, 1)

    def columns(self, nonlinear: Array) -> Array:
        """The same and their derivatives (R, c, r), by each of the nonlinear parameters (R, q) in turn."""
        terms = np.ones((len(nonlinear), 1))
        for k, order in enumerate(self.orders):
            place = 2.0 * (nonlinear[:, k] - self.low[k]) / (self.high[k] - self.low[k]) - 1.0
            one = chebvander(np.clip(place, -1.0, 1.0), order - 1)
            terms = (terms[:, :, None] * one[:, None, :]).reshape(len(terms), -1) if k else one
        return _product(terms, self._column_series).reshape(len(terms), self.column_count, self.rank)

    @cached_property
    def _column_series(self) -> Array:
        """Chebyshev coefficients (k_1 ... k_q, c r) of `columns`."""
        series = self.series.reshape(*self.orders, self.rank, -1)
        slopes = [
            chebder(series, scl=2.0 / (high - low), axis=axis)
            for axis, (low, high) in enumerate(zip(self.low, self.high, strict=True))
        ]
        for axis, slope in enumerate(slopes):
            slopes[axis] = np.concatenate([slope, np.zeros_like(np.take(series, [0], axis))], axis)
        together = np.swapaxes(np.stack([series, *slopes], axis=-3), -1, -2)
        return together.reshape(len(self.series), -1)

    @cached_property
    def gram(self) -> GramSeries:
        """Inner products, of a table over one parameter."""
        return gram_series(self.columns, float(self.low[0]), float(self.high[0]), self.orders[0])

    def project(self, measured: Array) -> tuple[Array, Array]:
        """Coordinates (R, r) of what was measured (R, n, 2), and the squares (R,) outside the space."""
        rows = measured.reshape(len(measured), -1) if self.complete else measured[:, self.good]
        inside = _product(rows, self.basis)
        squares = np.einsum("ri,ri->r", rows, rows)
        return inside, np.maximum(squares - np.einsum("ri,ri->r", inside, inside), 0.0)


def tabulate(problem: Problem, ranges: Mapping[str, tuple[float, float]] | None = None) -> Table:
    """The table of a problem's predictions, its nonlinear parameters within `ranges` (low, high).

    Linear parameters that are known are in the forced response. Raises ParameterError for a range that is
    missing or empty, for a problem with priors, where the channels do not tell the linear parameters apart,
    and where no series of MOST terms reaches TOLERANCE (take a narrower range or a shorter window).
    """
    ranges = ranges or {}
    for name in problem.nonlinear:
        if name not in ranges or not ranges[name][0] < ranges[name][1]:
            raise ParameterError(f"table: expected a range low < high of {name}, found {ranges.get(name)}")
    if problem.priors:
        raise ParameterError("table: expected no priors; fit one run after the other with them")
    low = np.array([ranges[name][0] for name in problem.nonlinear])
    high = np.array([ranges[name][1] for name in problem.nonlinear])
    orders: tuple[int, ...] = ()
    for axis in range(len(low)):
        # Alone first, the other parameters in the middle of their ranges.
        middle = 0.5 * (low + high)
        below, above = middle - 1e-9 * (high - low), middle + 1e-9 * (high - low)
        below[axis], above[axis] = low[axis], high[axis]
        first = [FIRST if k == axis else 1 for k in range(len(low))]
        orders += (_enough(problem, below, above, first, only=axis)[1][axis] + (2 if len(low) > 1 else 0),)
    table, _ = _enough(problem, low, high, list(orders))
    columns = table.coordinates(0.5 * (low + high)[None])[0, :, :-1]
    if problem.linear and not full_rank(columns, LINEAR_RANK):
        raise ParameterError(
            f"table: the measured channels do not tell {', '.join(problem.linear)} apart; free fewer of them"
        )
    return replace(table, error=_error(table))


def _enough(
    problem: Problem, low: Array, high: Array, orders: list[int], only: int | None = None
) -> tuple[Table, list[int]]:
    """The table with as many points as its tolerance needs, in all parameters or one; how many those are."""
    while True:
        table, tails = _table(problem, low, high, tuple(orders))
        short = [k for k, tail in enumerate(tails) if tail > TOLERANCE and only in (None, k)]
        if not short:
            return table, orders
        orders = [order + 4 * (k in short) for k, order in enumerate(orders)]
        if max(orders) > MOST:
            raise ParameterError(
                f"table: no series of {MOST} terms is exact to {TOLERANCE:g}; take narrower ranges or a"
                " shorter window"
            )


def _table(problem: Problem, low: Array, high: Array, orders: tuple[int, ...]) -> tuple[Table, Array]:
    """The table of some orders, and the size (q,) of the last two terms in each parameter."""
    good = np.isfinite(problem.window.measured)
    angles = [math.pi * (np.arange(order) + 0.5) / order for order in orders]
    nodes = [
        0.5 * (a + b) + 0.5 * (b - a) * np.cos(angle) for a, b, angle in zip(low, high, angles, strict=True)
    ]
    points = [np.array(point) for point in product(*nodes)]
    predictions = np.array([_rows(problem, point, good) for point in points])  # (N, m, p + 1)
    flat = predictions.transpose(1, 0, 2).reshape(predictions.shape[1], -1)
    scale = np.abs(predictions).max(axis=(0, 1))
    scale[scale == 0.0] = 1.0
    vectors, singular, _ = np.linalg.svd(flat / np.tile(scale, len(points)), full_matrices=False)
    basis = vectors[:, singular > TOLERANCE * singular[0]]
    inside = np.einsum("mr,nmp->nrp", basis, predictions)
    series = inside.reshape(*orders, -1)
    tails = []
    for axis, order in enumerate(orders):
        series = np.moveaxis(np.tensordot(chebyshev_transform(order), series, axes=(1, axis)), 0, axis)
    scaled = series.reshape(*orders, basis.shape[1], -1) / scale
    for axis in range(len(orders)):
        last = np.take(scaled, [-1] if orders[axis] == 1 else [-2, -1], axis=axis)
        tails.append(float(np.abs(last).max() / np.abs(scaled).max()))
    table = Table(problem, good, low, high, basis, series.reshape(max(len(points), 1), -1), orders, math.nan)
    return table, np.array(tails)


def _rows(problem: Problem, point: Array, good: NDArray[np.bool_]) -> Array:
    """Columns of the linear parameters and the forced response at one point (m, p + 1)."""
    values = dict(zip(problem.nonlinear, point.tolist(), strict=True))
    model = predictor(problem.window, {**problem.known_nonlinear, **values})
    return np.concatenate([model.select(problem.linear), model.predict(problem.known)[:, :, None]], axis=2)[
        good
    ]


def _error(table: Table) -> float:
    """Largest error between Chebyshev's points, per largest prediction."""
    places = [np.linspace(a, b, CHECKS + 2)[1:-1] for a, b in zip(table.low, table.high, strict=True)]
    points = np.array([np.array(point) for point in product(*places)]).reshape(
        math.prod(len(place) for place in places), len(places)
    )
    worst = 0.0
    for point, inside in zip(points, table.coordinates(points), strict=True):
        exact = _rows(table.problem, point, table.good)
        scale = np.abs(exact).max(axis=0)
        scale[scale == 0.0] = 1.0
        worst = max(worst, float((np.abs(table.basis @ inside - exact) / scale).max()))
    return worst


def _product(rows: Array, matrix: Array) -> Array:
    """Matrix product in parts so small that no threads start: on a busy machine they wait for each other."""
    found = np.empty((len(rows), matrix.shape[1]))
    step = max(THREADLESS // max(matrix.size, 1), 1)
    for k in range(0, len(rows), step):
        np.matmul(rows[k : k + step], matrix, out=found[k : k + step])
    return found
