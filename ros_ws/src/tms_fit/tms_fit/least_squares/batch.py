"""Least squares of many runs at once: simulated repetitions, bootstrap samples, runs with the same sampling.

The runs share one table of predictions. No step loops over runs, memory beyond the runs themselves is bounded
by chunks, and the cost is linear in the number of runs. Noise is taken as white, of the same variance in both
channels; the answers are those of `fit_window` with `noise="white"` (a test compares them).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t
from tms_model.bicycle import Array

from tms_fit.least_squares.single import HALVINGS, SETTLED, STEPS, fit_single
from tms_fit.least_squares.table import Table

CHUNK = 2_000_000  # numbers that a chunk's largest array may hold


@dataclass(frozen=True, eq=False)
class BatchEstimate:
    """Estimates of R runs; rows that did not converge, or ended at the table's edge, are marked."""

    names: tuple[str, ...]  # linear, then nonlinear
    values: Array  # (R, p)
    covariance: Array  # (R, p, p)
    residual_std: Array  # (R,) [rad/s]
    converged: NDArray[np.bool_]  # (R,)
    degrees_of_freedom: int

    @property
    def std(self) -> Array:
        """Standard errors (R, p)."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    @property
    def ci95(self) -> Array:
        """95 % intervals (R, p, 2), by Student's t."""
        half = float(student_t.ppf(0.975, max(self.degrees_of_freedom, 1))) * self.std
        return np.stack([self.values - half, self.values + half], axis=2)


def fit_batch(table: Table, measured: Array, start: Array | None = None) -> BatchEstimate:
    """Fit R runs (R, n, 2) [rad/s], sampled as the table's problem is; what is NaN there is not looked at.

    start: (q,) or (R, q) nonlinear values to begin with; None: as the problem's window knows them.
    """
    if len(measured) == 1 and len(table.orders) == 1 and table.problem.linear:
        first = table.start if start is None else np.asarray(start, dtype=float).ravel()
        value, spread, deviation, good = fit_single(table, measured[0], float(first[0]))
        return BatchEstimate(
            table.problem.names,
            value[None],
            spread[None],
            np.array([deviation]),
            np.array([good]),
            table.sample_count - len(value),
        )
    count, size = len(measured), max(table.rank * (len(table.problem.linear) + 1), table.sample_count)
    first = table.start if start is None else np.asarray(start, dtype=float)
    starts = np.broadcast_to(first, (count, len(table.orders)))
    step = max(CHUNK // (size * (1 + len(table.orders))), 1)
    parts = [_fit(table, measured[k : k + step], starts[k : k + step]) for k in range(0, count, step)]
    values, covariance, std, converged = (np.concatenate(part) for part in zip(*parts, strict=True))
    return BatchEstimate(
        table.problem.names, values, covariance, std, converged, table.sample_count - values.shape[1]
    )


def _fit(table: Table, measured: Array, start: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Values, covariances, residual deviations and convergence of one chunk."""
    inside, outside = table.project(measured)
    degrees = max(table.sample_count - len(table.problem.names), 1)
    nonlinear = np.clip(start, table.low, table.high)
    state = _Point.at(table, inside, nonlinear)
    active, done = np.arange(len(measured)), np.zeros(len(measured), dtype=bool)
    if not table.orders:
        done[:] = True
    for _ in range(STEPS):
        if done.all():
            break
        active = np.flatnonzero(~done)
        here = state.of(active)
        change, spread = here.step(outside[active], degrees)
        moved, better = _lower(table, inside[active], here, change)
        state = state.replaced(active, moved)
        small = (np.abs(change) <= SETTLED * spread + 1e-12 * (table.high - table.low)).all(axis=1)
        done[active] = small | ~better
    edge = (state.nonlinear <= table.low) | (state.nonlinear >= table.high)
    variance = (outside + state.squares) / degrees
    covariance = variance[:, None, None] * _inverse(state.normal)
    values = np.concatenate([state.linear, state.nonlinear], axis=1)
    return (
        values,
        covariance,
        np.sqrt(variance),
        done & ~edge.any(axis=1) & np.isfinite(covariance).all(axis=(1, 2)),
    )


@dataclass(frozen=True, eq=False)
class _Point:
    """A chunk at its nonlinear values, linear ones solved for."""

    nonlinear: Array  # (R, q)
    linear: Array  # (R, p)
    squares: Array  # (R,) of the residual inside the table's space
    normal: Array  # (R, p + q, p + q) of the joint Jacobian
    gradient: Array  # (R, q) by the nonlinear ones

    @classmethod
    def at(cls, table: Table, inside: Array, nonlinear: Array) -> _Point:
        """Solve for the linear parameters at nonlinear values (R, q)."""
        count, unknowns = len(table.problem.linear), len(table.orders)
        # (R, r, 1 + q, p + 1): columns of the linear parameters and forced response, then their derivatives.
        parts = table.columns(nonlinear).transpose(0, 2, 1).reshape(*inside.shape, 1 + unknowns, count + 1)
        columns = parts[:, :, 0, :count]
        target = inside - parts[:, :, 0, count]
        square = columns.transpose(0, 2, 1) @ columns
        along = np.einsum("rip,ri->rp", columns, target)
        linear = np.linalg.solve(square, along[:, :, None])[:, :, 0] if count else along
        residual = target - np.einsum("rip,rp->ri", columns, linear)
        whole = np.concatenate([linear, np.ones((len(linear), 1))], axis=1)
        by_nonlinear = np.einsum("riqp,rp->riq", parts[:, :, 1:], whole)
        jacobian = np.concatenate([columns, by_nonlinear], axis=2)
        return cls(
            nonlinear,
            linear,
            np.einsum("ri,ri->r", residual, residual),
            jacobian.transpose(0, 2, 1) @ jacobian,
            np.einsum("riq,ri->rq", by_nonlinear, residual),
        )

    def of(self, rows: NDArray[np.int_]) -> _Point:
        """Some of the runs."""
        if len(rows) == len(self.nonlinear):
            return self
        return _Point(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def replaced(self, rows: NDArray[np.int_], other: _Point) -> _Point:
        """The same with some runs from another."""
        if len(rows) == len(self.nonlinear):
            return other
        parts = []
        for name in self.__dataclass_fields__:
            part = getattr(self, name).copy()
            part[rows] = getattr(other, name)
            parts.append(part)
        return _Point(*parts)

    def step(self, outside: Array, degrees: int) -> tuple[Array, Array]:
        """Gauss and Newton's change of the nonlinear values (R, q), and their standard errors (R, q)."""
        count = self.linear.shape[1]
        inverse = _inverse(self.normal)[:, count:, count:]
        variance = (outside + self.squares) / degrees
        spread = np.sqrt(variance[:, None] * np.diagonal(inverse, axis1=1, axis2=2))
        return np.einsum("rij,rj->ri", inverse, self.gradient), spread


def _lower(table: Table, inside: Array, here: _Point, change: Array) -> tuple[_Point, NDArray[np.bool_]]:
    """The runs after a step, shortened until it leads downwards, and which of them found one that does."""
    best, share = here, np.ones((len(change), 1))
    open_ = np.arange(len(change))
    better = np.zeros(len(change), dtype=bool)
    for _ in range(HALVINGS):
        wanted = np.clip(here.nonlinear[open_] + share[open_] * change[open_], table.low, table.high)
        trial = _Point.at(table, inside[open_], wanted)
        lower = trial.squares <= here.squares[open_] * (1.0 + 1e-12)
        best = best.replaced(open_[lower], trial.of(np.flatnonzero(lower))) if lower.any() else best
        better[open_[lower]] = True
        open_ = open_[~lower]
        if not len(open_):
            break
        share[open_] *= 0.5
    return best, better


def _inverse(matrices: Array) -> Array:
    """Inverses (R, p, p); NaN for a run that does not tell the parameters apart, as one of zeros."""
    try:
        return np.asarray(np.linalg.inv(matrices), dtype=np.float64)
    except np.linalg.LinAlgError:
        told = np.linalg.det(matrices) != 0.0
        return np.asarray(np.linalg.inv(np.where(told[:, None, None], matrices, np.nan)), dtype=np.float64)
