"""Autoregressive noise model, averaged over its first reflection coefficient.

    e[t] = r[t] - a_1 r[t-1] - ... - a_p r[t-p], white, of variance s^2

A window of 1.5 s determines a correlation time of 0.2 s poorly, and intervals at the maximum-likelihood noise
parameters are far too narrow. So parameters and covariance are averaged over candidate noise models
(`tms_fit.noise.posterior`): the first reflection coefficient r of each channel, which is the lag-one
correlation of a process of order one, runs over a grid with a flat prior in artanh r. Higher coefficients are
Burg's; the order has the least BIC.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array

from tms_fit.noise.ar_process import ARChannelNoise, burg, grid_places, process
from tms_fit.noise.colored import ColoredNoise, colored_noise

GRID_STD_STEPS = np.linspace(-4.0, 9.0, 21)  # in artanh r, standard errors from Burg's coefficient
BIC_MARGIN = 6.0  # decrease of BIC by an autoregressive model; exceeded by one white channel in 500
MAX_ARTANH = 3.5  # largest artanh of a reflection coefficient: 0.998


@dataclass(frozen=True, eq=False)
class ARFamily:
    """Candidate autoregressive processes of a channel, with innovations of unit standard deviation."""

    members: tuple[ARChannelNoise, ...]

    @cached_property
    def log_determinants(self) -> Array:
        """Logarithm of the determinant (g,) of each candidate's covariance."""
        return np.array([noise.log_determinant for noise in self.members])

    def products(self, values: Array) -> Array:
        """Products (g, q, q) of whitened values, for values (m, q) of the samples."""
        rows = [noise.rows(values) for noise in self.members]
        return np.array([one.T @ one for one in rows])

    def member(self, index: int, std: float) -> ARChannelNoise:
        """One candidate with innovations of standard deviation std [rad/s]."""
        one = self.members[index]
        return ARChannelNoise(one.process, std, one.places, one.count)


@dataclass(frozen=True, eq=False)
class ARCandidates:
    """Grid of candidate processes of one channel by their reflection coefficients."""

    first: Array  # (g,) first reflection coefficients, ascending; (0,): white noise
    further: Array  # (p - 1,) those of higher orders

    def within(self, low: float, high: float) -> ARCandidates:
        """Grid of the same size between two values of artanh of the first coefficient."""
        around = np.clip(np.linspace(low, high, len(GRID_STD_STEPS)), -MAX_ARTANH, MAX_ARTANH)
        return ARCandidates(np.unique(np.tanh(around)), self.further)


def fit(time: Array, residual: Array, jacobian: Array) -> ColoredNoise:
    """Likeliest noise with its candidates, from residuals (n, 2) of a fit with derivatives (n, 2, p)."""
    good = np.isfinite(residual)
    channels = [c for c in range(2) if good[:, c].sum() > 2]
    found = {c: candidates([residual[good[:, c], c]]) for c in channels}
    return colored_noise(families(time, good, found), residual, jacobian)


def is_autocorrelated(*residuals: Array) -> bool:
    """Whether residuals (n, 2) of one run or several are autocorrelated in some channel.

    The criterion is a decrease of BIC by more than BIC_MARGIN.
    """
    for c in range(2):
        segments = [residual[np.isfinite(residual[:, c]), c] for residual in residuals]
        segments = [values for values in segments if len(values) > 2 and values.any()]
        if segments:
            reflections, std = burg(*segments)
            count = sum(len(values) for values in segments)
            fall = -count * math.log(std**2 / float(np.mean(np.concatenate(segments) ** 2)))
            if fall - len(reflections) * math.log(count) > BIC_MARGIN:
                return True
    return False


def candidates(residuals: Sequence[Array]) -> ARCandidates:
    """Candidate processes of a channel from its residuals (n,) in each run; white without autocorrelation.

    The grid is as wide as one run requires, since the fit of each run reduces the correlation of its
    residuals.
    """
    reflections, _ = burg(*residuals)
    if not len(reflections):
        return ARCandidates(reflections, reflections)
    first = float(np.clip(reflections[0], -0.99, 0.99))
    count = sum(len(values) for values in residuals) / len(residuals)
    std = 1.0 / math.sqrt(count * (1.0 - first**2))
    around = np.clip(math.atanh(first) + std * GRID_STD_STEPS, -MAX_ARTANH, MAX_ARTANH)
    return ARCandidates(np.unique(np.tanh(around)), reflections[1:])


def families(time: Array, good: NDArray[np.bool_], found: Mapping[int, ARCandidates]) -> dict[int, ARFamily]:
    """Candidate processes by channel at the samples of a run: times (n,) [s], measured (n, 2)."""
    places = grid_places(time)
    return {c: _family(places[good[:, c]], one) for c, one in found.items() if good[:, c].sum() > 2}


def _family(places: NDArray[np.int_], found: ARCandidates) -> ARFamily:
    grid = places - places[0]
    orders = [np.append(one, found.further) for one in found.first] or [found.further]
    return ARFamily(tuple(ARChannelNoise(process(one), 1.0, grid, int(grid[-1]) + 1) for one in orders))
