"""Least squares of one run by a table, for whoever can't wait: a fraction of a millisecond.

The same steps as `tms_fit.least_squares.batch`, for one run and one nonlinear parameter, with as few calls
as they need.
"""

from __future__ import annotations

import math

import numpy as np
from tms_model.bicycle import Array

from tms_fit.least_squares.table import Table

STEPS = 30  # at most, of Gauss and Newton
SETTLED = 1e-5  # last step, in standard errors
HALVINGS = 12  # of a step that leads upwards


def fit_single(table: Table, measured: Array, start: float) -> tuple[Array, Array, float, bool]:
    """Values (p + 1,), covariance, residual deviation [rad/s] and whether they converged, of a run (n, 2)."""
    rows = measured.ravel() if table.complete else measured[table.good]
    inside = rows @ table.basis
    outside = max(float(rows @ rows) - float(inside @ inside), 0.0)
    low, high = float(table.low[0]), float(table.high[0])
    degrees = max(len(rows) - len(table.problem.names), 1)
    value = min(max(start, low), high)
    linear, squares, normal, gradient = _at(table, inside, value)
    converged = False
    for _ in range(STEPS):
        # The change and variance of the last unknown, by Schur's complement of the linear ones.
        cross = normal[:-1, -1]
        left = float(normal[-1, -1])
        if len(cross) == 1:
            left -= float(cross[0]) ** 2 / float(normal[0, 0])
        elif len(cross):
            left -= float(cross @ np.linalg.solve(normal[:-1, :-1], cross))
        change = gradient / left
        spread = math.sqrt((outside + squares) / degrees / left)
        better = False
        for halving in range(HALVINGS):
            wanted = min(max(value + change * 0.5**halving, low), high)
            trial = _at(table, inside, wanted)
            if trial[1] <= squares * (1.0 + 1e-12):
                value, better = wanted, True
                linear, squares, normal, gradient = trial
                break
        if abs(change) <= SETTLED * spread + 1e-12 * (high - low) or not better:
            converged = low < value < high
            break
    variance = (outside + squares) / degrees
    covariance = np.asarray(variance * np.linalg.inv(normal), dtype=np.float64)
    return np.append(linear, value), covariance, math.sqrt(variance), converged


def _at(table: Table, inside: Array, value: float) -> tuple[Array, float, Array, float]:
    """Linear values (p,), squares inside the table's space, J'J (p + 1, p + 1) and the last's gradient."""
    half = 0.5 * (float(table.high[0]) - float(table.low[0]))
    cosine = min(max((value - float(table.low[0])) / half - 1.0, -1.0 + 1e-13), 1.0 - 1e-13)
    angle = math.acos(cosine)
    turns = angle * table.degrees
    terms = np.empty((2, len(turns)))
    np.cos(turns, out=terms[0])
    np.sin(turns, out=terms[1])
    terms[1] *= table.degrees / (half * math.sin(angle))
    columns, slopes = (terms @ table.series).reshape(2, table.rank, -1)
    count = columns.shape[1] - 1
    jacobian = np.empty((table.rank, count + 1))
    jacobian[:, :count] = columns[:, :count]
    target = inside - columns[:, count]
    if count == 1:
        column = jacobian[:, 0]
        linear = np.array([float(column @ target) / float(column @ column)])
        residual = target - linear[0] * column
    else:
        column = jacobian[:, :count]
        linear = np.linalg.solve(column.T @ column, column.T @ target)
        residual = target - column @ linear
    jacobian[:, count] = slopes[:, :count] @ linear + slopes[:, count]
    normal = jacobian.T @ jacobian
    return linear, float(residual @ residual), normal, float(jacobian[:, count] @ residual)
