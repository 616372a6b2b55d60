"""Confidence intervals by profile likelihood and by block bootstrap.

`profile`: increase of the sum of squares with one parameter fixed and all others refitted. It is scaled to
agree near the estimate with the stated standard error, which includes other uncertainty (autocorrelated
noise, speed, strike time). For a response linear in its parameters it equals the interval by the covariance.

`bootstrap`: residuals resampled in blocks, added to the prediction and refitted by one Gauss-Newton step
each, with nuisance parameters drawn from their distribution. It assumes no distribution, but needs a window
of many blocks: it underestimates noise that is correlated over more than a block.

References: D. M. Bates and D. G. Watts, "Nonlinear Regression Analysis and Its Applications", Wiley (1988),
doi 10.1002/9780470316757, section 6.1 (profile t); H. R. Kuensch, Ann. Statist. 17 (1989), doi
10.1214/aos/1176347265 (blocks).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from tms_model.bicycle import Array

from tms_fit.estimate import Estimate
from tms_fit.least_squares.irls import Fitted, fit_problem
from tms_fit.least_squares.losses import Loss
from tms_fit.least_squares.model_selection import specify_model
from tms_fit.least_squares.nuisance import nuisance_covariance
from tms_fit.least_squares.problem import Problem, solve
from tms_fit.parameters import STRIKE
from tms_fit.settings import Settings
from tms_fit.window import Window

MAX_DISTANCE = 8.0  # standard errors between the estimate and an end of its interval
PROFILE_POINTS = 21
REPLICATES = 2000
BLOCK_S = 0.25
SEED = 2011


@dataclass(frozen=True, eq=False)
class Profile:
    """Profile t of one parameter: signed distance of the fit from its best with that parameter fixed."""

    name: str
    values: Array  # (n,) of the parameter, ascending
    t: Array  # (n,), NaN where the other parameters have no minimum
    interval: tuple[float, float]  # where |t| is the quantile, infinite where it isn't reached


def with_intervals(window: Window, estimate: Estimate, settings: Settings) -> Estimate:
    """Estimate with 95 % intervals by the method of the settings; by the covariance for a strike's force."""
    if settings.intervals == "wald" or estimate.status != "ok" or STRIKE[0] in estimate:
        return estimate
    if settings.intervals == "profile":
        profiles = [profile(window, estimate, settings, name) for name in estimate.names]
        return replace(estimate, intervals=np.array([one.interval for one in profiles]))
    deviations = bootstrap(window, estimate, settings, np.random.default_rng(SEED))
    # Basic bootstrap: the upper quantile of the error gives the lower end of the interval.
    low, high = np.quantile(deviations, [0.975, 0.025], axis=0)
    return replace(estimate, intervals=np.stack([estimate.values - low, estimate.values - high], axis=1))


def profile(window: Window, estimate: Estimate, settings: Settings, name: str) -> Profile:
    """Profile t of parameter `name` of an estimate."""
    problem, fitted = _solved_again(window, estimate, settings)
    value, std = estimate[name].value, estimate[name].std
    distance = _distance(problem, fitted, name, value)
    step = 0.05 * std
    slope = 0.5 * (distance(value + step) - distance(value - step)) / step

    def t(held: float) -> float:
        return distance(held) / (slope * std)

    ends = tuple(_end(t, value, side * std, estimate.quantile) for side in (-1.0, 1.0))
    reach = [min(abs(end - value), MAX_DISTANCE * std) for end in ends]
    values = value + np.linspace(-1.3 * reach[0], 1.3 * reach[1], PROFILE_POINTS)
    return Profile(name, values, np.array([t(float(one)) for one in values]), (ends[0], ends[1]))


def bootstrap(window: Window, estimate: Estimate, settings: Settings, rng: np.random.Generator) -> Array:
    """Errors (REPLICATES, p) of estimates from resampled residuals, in the order of `estimate.names`."""
    problem, fitted = _solved_again(window, estimate, settings)
    solution = fitted.solution
    residual = problem.window.measured - problem.predicted(solution.values)
    good = np.isfinite(residual)
    count = int(good.sum())
    residual = residual * math.sqrt(count / max(count - len(problem.names), 1))
    drawn = _blocks(problem.window.time, residual, rng)
    rows = np.stack([fitted.noise.rows(one) for one in drawn])
    errors = rows @ solution.jacobian[: rows.shape[1]] @ solution.of_rows
    known = nuisance_covariance(problem, solution, fitted.noise.rows)
    errors += rng.multivariate_normal(np.zeros(len(known)), known, len(errors), method="svd")
    answer: Array = errors[:, [problem.names.index(name) for name in estimate.names]]
    return answer


def _solved_again(window: Window, estimate: Estimate, settings: Settings) -> tuple[Problem, Fitted]:
    """Problem of an estimate, and its solution under the estimated noise model."""
    asked = replace(settings, free=estimate.names, noise=estimate.noise_model, loss=estimate.loss)
    if asked.noise != "oscillator":
        asked = replace(asked, oscillator=())
    problem = specify_model(window, asked).problem
    return problem, fit_problem(problem, asked.noise, Loss(asked.loss), asked.oscillator)


def _distance(problem: Problem, fitted: Fitted, name: str, value: float) -> Callable[[float], float]:
    """Signed root of the increase of the sum of squares as a function of the fixed value of a parameter."""
    linear = tuple(one for one in problem.linear if one != name)
    nonlinear = tuple(one for one in problem.nonlinear if one != name)
    start = fitted.solution.values[[problem.names.index(one) for one in nonlinear]]

    def squares(held: float) -> float:
        moved = replace(
            problem,
            linear=linear,
            nonlinear=nonlinear,
            known={**problem.known, name: held},
            priors={one: prior for one, prior in problem.priors.items() if one != name},
        )
        if not moved.names:
            rows = fitted.noise.rows(problem.window.measured - moved.predicted(np.empty(0)))
            return float(rows @ rows)
        solution = solve(moved, fitted.noise.rows, start)
        return float(solution.rows @ solution.rows) if solution.status == "ok" else math.nan

    least = squares(value)

    def distance(held: float) -> float:
        return math.copysign(math.sqrt(max(squares(held) - least, 0.0)), held - value)

    return distance


def _end(t: Callable[[float], float], value: float, std: float, quantile: float) -> float:
    """Value at which |t| reaches the quantile on the side of the sign of std; infinite if it doesn't."""
    last = value
    for far in np.arange(1.0, MAX_DISTANCE + 0.5):
        now = value + far * std
        reached = abs(t(now))
        if not math.isfinite(reached):
            break
        if reached >= quantile:
            from scipy.optimize import brentq

            return float(brentq(lambda held: abs(t(held)) - quantile, last, now, xtol=1e-6 * abs(std)))
        last = now
    return math.copysign(math.inf, std)


def _blocks(time: Array, residual: Array, rng: np.random.Generator) -> Array:
    """Residuals (REPLICATES, n, 2), drawn in blocks of BLOCK_S; NaN stays where nothing was measured.

    Where a block brings nothing for a measured sample, a residual of that channel is drawn by itself.
    """
    count = len(time)
    length = max(1, min(round(BLOCK_S * (count - 1) / max(float(time[-1] - time[0]), 1e-9)), count))
    starts = rng.integers(0, count - length + 1, (REPLICATES, -(-count // length)))
    index = (starts[:, :, None] + np.arange(length)).reshape(REPLICATES, -1)[:, :count]
    drawn: Array = residual[index]
    for channel in range(residual.shape[1]):
        there = residual[np.isfinite(residual[:, channel]), channel]
        absent = ~np.isfinite(drawn[:, :, channel])
        if len(there):
            drawn[:, :, channel][absent] = rng.choice(there, int(absent.sum()))
        drawn[:, ~np.isfinite(residual[:, channel]), channel] = np.nan
    return drawn
