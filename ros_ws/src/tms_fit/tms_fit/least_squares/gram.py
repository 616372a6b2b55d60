"""Inner products of a table's predictions, as Chebyshev series in its one nonlinear parameter.

A step of least squares needs no prediction, only inner products of the columns of the linear parameters, of
the slopes, and of the target. The slopes are derivatives by the nonlinear parameter of these columns, and of
the forced response if there is one; the target is what was measured less the forced response. What of that
no run can change is made once for a table.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from tms_model.bicycle import Array


@dataclass(frozen=True, eq=False)
class GramSeries:
    """Of p columns, s slopes and the target, in this order; the target as if nothing had been measured."""

    low: float  # ends of the nonlinear parameter's range
    high: float
    column_count: int  # p
    slope_count: int  # s: p, or p + 1 with a forced response
    degrees: Array  # (k,) of the Chebyshev polynomials
    among: Array  # (k, p + s + 1, p + s + 1) their coefficients
    with_run: Array  # (k (p + s + 1), r) what a run's coordinates (r,) add to the target's column

    def of_run(self, inside: Array, square: float) -> Array:
        """Coefficients (k, (p + s + 1)^2) with a run: its coordinates (r,), and its squares in all."""
        found = self.among.copy()
        found[:, :, -1] += (self.with_run @ inside).reshape(len(found), -1)
        found[:, -1] = found[:, :, -1]
        found[0, -1, -1] += square
        return found.reshape(len(found), -1)

    def at(self, series: Array, value: float) -> list[float]:
        """Gram matrix of a run at a value of the nonlinear parameter, row by row."""
        cosine = min(max(2.0 * (value - self.low) / (self.high - self.low) - 1.0, -1.0), 1.0)
        numbers: list[float] = (np.cos(math.acos(cosine) * self.degrees) @ series).tolist()
        return numbers


def gram_series(columns: Callable[[Array], Array], low: float, high: float, order: int) -> GramSeries:
    """Of a table whose series have `order` terms; columns: `Table.columns`."""
    count = 2 * order - 1  # terms of a product
    angles = math.pi * (np.arange(count) + 0.5) / count
    parts = columns(low + 0.5 * (high - low) * (1.0 + np.cos(angles))[:, None])  # (k, 2 (p + 1), r)
    linear = parts.shape[1] // 2 - 1
    forced = parts[:, linear]
    slopes = parts[:, linear + 1 :] if forced.any() else parts[:, linear + 1 : -1]
    factors = np.concatenate([parts[:, :linear], slopes, -forced[:, None]], axis=1)
    # The target is the run and the last factor: of its square the run adds twice their product, and its own.
    alone = factors.copy()
    alone[:, -1] *= 2.0
    transform = chebyshev_transform(count)
    return GramSeries(
        low,
        high,
        column_count=linear,
        slope_count=slopes.shape[1],
        degrees=np.arange(count, dtype=float),
        among=np.tensordot(transform, factors @ factors.transpose(0, 2, 1), axes=1),
        with_run=np.tensordot(transform, alone, axes=1).reshape(-1, factors.shape[2]),
    )


def chebyshev_transform(order: int) -> Array:
    """Coefficients of a series, by the values at as many of Chebyshev's points, (k, k)."""
    angles = math.pi * (np.arange(order) + 0.5) / order
    transform: Array = 2.0 / order * np.cos(np.outer(np.arange(order), angles))
    transform[0] *= 0.5
    return transform
