"""Least squares of one run by a table, for whoever can't wait: less than a tenth of a millisecond.

The same steps as `tms_fit.least_squares.batch`, for one run and one nonlinear parameter. At this size a call
of numpy costs more than its arithmetic, so there are few: a step sums the series of
`tms_fit.least_squares.gram` in one product, and goes on with plain numbers.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from tms_model.bicycle import Array

from tms_fit.least_squares.gram import GramSeries
from tms_fit.least_squares.table import Table

STEPS = 30  # at most, of Gauss and Newton
SETTLED = 1e-5  # last step, in standard errors
HALVINGS = 12  # of a step that leads upwards
ROUNDING = 1e-14  # of the squares, per squares of what was measured


class _Point(NamedTuple):
    """A run at one value of the nonlinear parameter, linear ones solved for."""

    swept: list[list[float]]  # Gram matrix of columns, slopes and target, see `_swept`
    weights: list[float]  # of the slopes: the linear parameters (p,), and 1 for a forced response
    squares: float  # of the residual
    gradient: float  # of half the squares, downwards
    curvature: float  # J'J of the nonlinear parameter, without what the linear ones explain


def fit_single(table: Table, measured: Array, start: float) -> tuple[Array, Array, float, bool]:
    """Values (p + 1,), covariance, residual deviation [rad/s] and whether they converged, of a run (n, 2)."""
    rows = measured.ravel() if table.complete else measured[table.good]
    gram, whole = table.gram, float(rows @ rows)
    series, low, high = gram.of_run(rows @ table.basis, whole), gram.low, gram.high
    degrees = max(len(rows) - gram.column_count - 1, 1)
    value, change, converged = min(max(start, low), high), 0.0, False
    here = _at(gram, series, value)
    for _ in range(STEPS):
        if not here.curvature > 0.0:  # nothing measured depends on it, or nothing is measured
            break
        change = here.gradient / here.curvature
        spread = math.sqrt(max(here.squares, 0.0) / degrees / here.curvature)
        if abs(change) <= SETTLED * spread + 1e-12 * (high - low):
            converged = low < value + change < high
            break
        for halving in range(HALVINGS):
            wanted = min(max(value + change * 0.5**halving, low), high)
            trial = _at(gram, series, wanted)
            if trial.squares <= here.squares * (1.0 + 1e-12) + ROUNDING * whole:
                value, here, change = wanted, trial, 0.0
                break
        else:
            change, converged = 0.0, low < value < high  # nothing better is within reach: rounding
            break
    variance = max(here.squares, 0.0) / degrees
    explained = _explained(here, gram.column_count)
    # So small a step changes the linear parameters in proportion.
    values = [a - change * b for a, b in zip(here.weights, explained, strict=False)]
    values.append(min(max(value + change, low), high))
    covariance = np.array(_covariance(here, explained, variance))
    return np.array(values), covariance, math.sqrt(variance), converged


def _at(gram: GramSeries, series: Array, value: float) -> _Point:
    columns = gram.column_count
    swept = _swept(gram.at(series, value), columns, columns + gram.slope_count + 1)
    weights = [row[-1] for row in swept[:columns]] + [1.0] * (gram.slope_count - columns)
    # The derivative of the prediction is the sum of the slopes, weighed as their columns are.
    gradient = curvature = 0.0
    for weight, row in zip(weights, swept[columns:], strict=False):
        gradient += weight * row[-1]
        for other, number in zip(weights, row[columns:], strict=False):
            curvature += weight * other * number
    return _Point(swept, weights, swept[-1][-1], gradient, curvature)


def _swept(gram: list[float], count: int, size: int) -> list[list[float]]:
    """A Gram matrix [[A, B], [B', C]] as [[A^-1, A^-1 B], [-B' A^-1, C - B' A^-1 B]], A of its first columns.

    J. H. Goodnight, The American Statistician 33 (1979), doi 10.1080/00031305.1979.10482685.
    """
    rows, every = [gram[k : k + size] for k in range(0, size * size, size)], range(size)
    for k in range(count):
        pivot = rows[k]
        scale, pivot[k] = 1.0 / pivot[k], 1.0
        for j in every:
            pivot[j] *= scale
        for row in rows:
            if row is not pivot:
                share, row[k] = row[k], 0.0
                for j in every:
                    row[j] -= share * pivot[j]
    return rows


def _explained(here: _Point, columns: int) -> list[float]:
    """How much of each column (p,) the derivative by the nonlinear parameter contains."""
    found = []
    for row in here.swept[:columns]:
        total = 0.0
        for weight, number in zip(here.weights, row[columns:], strict=False):
            total += weight * number
        found.append(total)
    return found


def _covariance(here: _Point, explained: list[float], variance: float) -> list[list[float]]:
    """Covariance (p + 1, p + 1), by its blocks."""
    last = variance / here.curvature if here.curvature else math.inf
    rows = []
    for row, one in zip(here.swept, explained, strict=False):
        rows.append([variance * a + last * one * b for a, b in zip(row, explained, strict=False)])
        rows[-1].append(-last * one)
    rows.append([-last * one for one in explained])
    rows[-1].append(last)
    return rows
