"""Saturated samples of a fit as censored data: working values, weights and noise variance.

The formulas, with their references, are those of `tms_fit.least_squares.censoring`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from tms_model.bicycle import Array

from tms_fit.least_squares import censoring
from tms_fit.least_squares.problem import Problem, ProblemSolution
from tms_fit.noise import Noise
from tms_fit.noise.white import White

MAX_STD_STEPS = 200  # of expectation maximisation
STD_TOLERANCE = 1e-6  # last relative change of the standard deviation


@dataclass(frozen=True, eq=False)
class SaturatedSamples:
    """Saturated samples of a window with their limits."""

    rows: Array  # (n, 2) bool
    sign: Array  # (m,) +1: above the limit, -1: below
    limit: Array  # (m,) [rad/s]

    def _at(self, function: Callable[..., Array], predicted: Array, std: float) -> Array:
        return function(self.limit, self.sign, predicted[self.rows], std)

    def replaced(self, problem: Problem, solution: ProblemSolution, noise: Noise) -> Problem:
        """Problem with each saturated sample at its working value."""
        assert isinstance(noise, White)
        window = problem.window
        measured = window.measured
        measured[self.rows] = self._at(censoring.working, problem.predicted(solution.values), noise.std)
        return replace(problem, window=replace(window, lean_rate=measured[:, 0], yaw_rate=measured[:, 1]))

    def std(self, problem: Problem, residual: Array, unknowns: int, std: float) -> float:
        """Standard deviation [rad/s] of the noise, the variance of the saturated samples included.

        Each step of expectation maximisation reduces the error by the share of samples that are not
        saturated, so the steps are repeated until convergence.
        """
        good = np.isfinite(residual)
        predicted = problem.window.measured - residual
        off = np.where(good & np.logical_not(self.rows), residual, 0.0)
        squares, count = float(np.sum(off**2)), max(int(good.sum()) - unknowns, 1)
        for _ in range(MAX_STD_STEPS):
            spread = float(np.sum(self._at(censoring.excess, predicted, std))) * std**2
            beyond = self._at(censoring.expected, predicted, std) - predicted[self.rows]
            before, std = std, math.sqrt((squares + float(beyond @ beyond) + spread) / count)
            if abs(std - before) <= STD_TOLERANCE * std:
                break
        return std

    def information(self, problem: Problem, solution: ProblemSolution, noise: Noise) -> Array:
        """Fisher information (m,) of each measured sample relative to an uncensored one."""
        assert isinstance(noise, White)
        share = np.ones(self.rows.shape)
        predicted = problem.predicted(solution.values)
        share[self.rows] = self._at(censoring.information, predicted, noise.std)
        kept: Array = share[noise.good]
        return kept


def saturated_samples(problem: Problem) -> SaturatedSamples | None:
    """Saturated samples of a problem's window; None without any."""
    window = problem.window
    if window.saturated is None or not window.saturated.any():
        return None
    rows = (window.saturated != 0.0) & np.isfinite(window.measured)
    return SaturatedSamples(rows, window.saturated[rows], window.measured[rows])
