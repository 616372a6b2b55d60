"""Autoregressive processes: exact whitening with missing samples, autocovariances, Burg's method.

References: J. P. Burg, thesis (1975); N. Levinson (1947) and J. Durbin (1960) for the filters of all orders;
R. H. Jones, Technometrics 22 (1980), doi 10.1080/00401706.1980.10486171, for missing samples.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array

MAX_ORDER = 8


@dataclass(frozen=True, eq=False)
class ARProcess:
    """Autoregressive process in units of its innovations, with prediction filters of orders 0 to p."""

    filters: tuple[Array, ...]  # filters[k]: (k,) coefficients to predict from the last k samples
    variances: Array  # (p + 1,) of their prediction errors, in innovation variances; the last is 1

    @property
    def order(self) -> int:
        """Order of the process: number of past samples that predict the next."""
        return len(self.filters) - 1

    def whiten(self, values: Array) -> Array:
        """Whitened values (n, ...) of unit variance at equal steps, exact from the first sample on."""
        white = np.array(values)
        for k, weight in enumerate(self.filters[-1]):
            white[self.order :] -= weight * values[self.order - 1 - k : len(values) - 1 - k]
        for row in range(min(self.order, len(values))):
            for k, weight in enumerate(self.filters[row]):
                white[row] -= weight * values[row - 1 - k]
            white[row] /= math.sqrt(self.variances[row])
        return white

    def log_determinant(self, count: int) -> float:
        """Logarithm of the determinant of the covariance of `count` samples."""
        return float(np.sum(np.log(self.variances[: min(count, self.order)])))


def process(reflections: Array) -> ARProcess:
    """Process with reflection coefficients (p,) between -1 and 1, by Levinson's recursion."""
    filters, variances = [np.empty(0)], [1.0]
    for reflection in reflections:
        last = filters[-1]
        filters.append(np.append(last - reflection * last[::-1], reflection))
        variances.append(variances[-1] * (1.0 - float(reflection) ** 2))
    return ARProcess(tuple(filters), np.array(variances) / variances[-1])


def autocovariances(processes: Sequence[ARProcess], count: int) -> Array:
    """Autocovariances (m, count) of processes of one order, in innovation variances."""
    order = processes[0].order
    found = np.zeros((len(processes), count))
    found[:, 0] = [one.variances[0] for one in processes]
    weights = np.zeros((len(processes), order))
    # Levinson: the filter of order k applied to the preceding lags gives the covariance at lag k.
    for k in range(1, count):
        if k <= order:
            weights = np.array([one.filters[k] for one in processes])
        before = found[:, max(k - order, 0) : k][:, ::-1]  # empty for white noise
        found[:, k] = np.einsum("mi,mi->m", weights, before)
    return found


@dataclass(frozen=True, eq=False)
class ARChannelNoise:
    """Autoregressive noise of one channel on a grid of equal steps with missing samples."""

    process: ARProcess
    std: float  # [rad/s] of the innovations
    places: NDArray[np.int_]  # (m,) of the samples on the grid
    count: int  # of the grid

    def rows(self, values: Array) -> Array:
        """Whitened rows (count, ...) of unit variance for values (m, ...) of the samples."""
        grid = np.zeros((self.count, *values.shape[1:]))
        grid[self.places] = values
        white = self.process.whiten(grid)
        if len(self.places) < self.count:
            unit = self._missing()
            flat = white.reshape(self.count, -1)
            flat = flat - unit @ np.linalg.lstsq(unit, flat, rcond=None)[0]
            white = flat.reshape(white.shape)
        rows: Array = white / self.std
        return rows

    def innovations(self, values: Array) -> Array:
        """Whitened values (m,) of unit variance at the samples."""
        return self.rows(values)[self.places]

    def at(self, time: Array) -> ARChannelNoise:
        """The same noise at other samples (m,) [s], at the same steps."""
        places = grid_places(time)
        return ARChannelNoise(self.process, self.std, places, int(places[-1]) + 1)

    @property
    def parameters(self) -> dict[str, float]:
        """Standard deviation of the innovations [rad/s] and coefficients."""
        weights = {f"ar{k + 1}": float(weight) for k, weight in enumerate(self.process.filters[-1])}
        return {"innovation_std": self.std, **weights}

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the samples' covariance."""
        found = self.process.log_determinant(self.count) + 2.0 * math.log(self.std) * len(self.places)
        if len(self.places) < self.count:
            unit = self._missing()
            found += float(np.linalg.slogdet(unit.T @ unit)[1])
        return found

    def _missing(self) -> Array:
        """Whitened unit impulses (count, missing) at the places without sample."""
        missing = np.setdiff1d(np.arange(self.count), self.places)
        unit = np.zeros((self.count, len(missing)))
        unit[missing, np.arange(len(missing))] = 1.0
        return self.process.whiten(unit)


def grid_places(time: Array) -> NDArray[np.int_]:
    """Places (n,) of samples at times (n,) [s] on a grid of equal steps; 0 to n - 1 if none fits."""
    numbers = np.arange(len(time))
    if len(time) < 3:
        return numbers
    places = np.round(
        np.cumsum(np.round(np.diff(time, prepend=time[0]) / np.median(np.diff(time)), 0))
    ).astype(int)
    return places if (np.diff(places) > 0).all() and places[-1] <= 3 * len(time) else numbers


def burg(*segments: Array) -> tuple[Array, float]:
    """Reflection coefficients (p,) of the order with the least BIC, and innovations' standard deviation.

    segments: values (n,) of one process in each run; no prediction crosses from one run to the next.
    """
    errors = [(values[1:].copy(), values[:-1].copy()) for values in segments]
    count = sum(len(values) for values in segments)
    variance = float(np.mean(np.concatenate(segments) ** 2))
    reflections: list[float] = []
    best, found = math.inf, (np.empty(0), math.sqrt(variance) or 1.0)
    for order in range(min(MAX_ORDER, count // 20) + 1):
        if not variance > 0.0:
            break
        criterion = count * math.log(variance) + order * math.log(count)
        if criterion < best:
            best, found = criterion, (np.array(reflections), math.sqrt(variance))
        energy = sum(float(forward @ forward + backward @ backward) for forward, backward in errors)
        if not energy > 0.0:
            break
        reflection = 2.0 * sum(float(forward @ backward) for forward, backward in errors) / energy
        reflections.append(reflection)
        variance *= 1.0 - reflection**2
        errors = [
            ((forward - reflection * backward)[1:], (backward - reflection * forward)[:-1])
            for forward, backward in errors
        ]
    return found
