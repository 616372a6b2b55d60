"""Coloured noise: an autoregressive process of each channel, as the residuals show it.

    e[t] = r[t] - a_1 r[t-1] - ... - a_p r[t-p], white, of variance s^2

A second and a half of noise that is correlated over a fifth of a second says little about that correlation,
and the noise parameters of greatest likelihood, taken for the truth, give intervals that are far too narrow.
So the answer is an average over what the noise may be (`tms_fit.least_squares.noise.posterior`): the first
reflection coefficient r of each channel, which for order one is the correlation of neighbours, runs over a
grid with a flat prior in artanh r. Higher coefficients are Burg's, their number has the least BIC.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array

from tms_fit.least_squares.noise.coloured import Coloured, coloured
from tms_fit.least_squares.noise.process import ProcessNoise, burg, grid_places, process

PLACES = np.linspace(-4.0, 9.0, 21)  # of the grid, in standard errors from Burg's coefficient, in artanh
CLEAR = 6.0  # fall of BIC from which on residuals are called coloured: once in 500 white channels
LIMIT = 3.5  # largest artanh of a reflection coefficient: 0.998


@dataclass(frozen=True, eq=False)
class ProcessFamily:
    """Autoregressive processes that a channel's noise may be, each of innovations of deviation one."""

    members: tuple[ProcessNoise, ...]

    @cached_property
    def log_determinants(self) -> Array:
        """Of each candidate's covariance (g,)."""
        return np.array([noise.log_determinant for noise in self.members])

    def products(self, values: Array) -> Array:
        """Whitened values' products (g, q, q), of values (m, q) of the samples."""
        rows = [noise.rows(values) for noise in self.members]
        return np.array([one.T @ one for one in rows])

    def member(self, index: int, std: float) -> ProcessNoise:
        """One candidate with innovations of a deviation [rad/s]."""
        one = self.members[index]
        return ProcessNoise(one.process, std, one.places, one.count)


def fit(time: Array, residual: Array, jacobian: Array) -> Coloured:
    """The noise that residuals (n, 2) show, whose fit had the derivatives (n, 2, p)."""
    good = np.isfinite(residual)
    places = grid_places(time)
    families = {
        c: _family(places[good[:, c]], residual[good[:, c], c]) for c in range(2) if good[:, c].sum() > 2
    }
    return coloured(families, good, residual, jacobian)


def remembers(residual: Array) -> bool:
    """Whether residuals (n, 2) of some channel are no white noise: BIC falls by more than CLEAR."""
    for channel in residual.T:
        values = channel[np.isfinite(channel)]
        if len(values) > 2 and values.any():
            reflections, std = burg(values)
            fall = -len(values) * math.log(std**2 / float(np.mean(values**2)))
            if fall - len(reflections) * math.log(len(values)) > CLEAR:
                return True
    return False


def _family(places: NDArray[np.int_], residual: Array) -> ProcessFamily:
    """What a channel's noise may be: one member if it shows no memory at all."""
    grid = places - places[0]
    reflections, _ = burg(residual)
    if not len(reflections):
        return ProcessFamily((ProcessNoise(process(reflections), 1.0, grid, int(grid[-1]) + 1),))
    first = float(np.clip(reflections[0], -0.99, 0.99))
    std = 1.0 / math.sqrt(len(residual) * (1.0 - first**2))
    around = np.clip(math.atanh(first) + std * PLACES, -LIMIT, LIMIT)
    return ProcessFamily(
        tuple(
            ProcessNoise(process(np.append(one, reflections[1:])), 1.0, grid, int(grid[-1]) + 1)
            for one in np.unique(np.tanh(around))
        )
    )
