"""Nuisance parameters: first-order propagation of their uncertainty to the covariance.

Nuisance parameters are the strike time between two samples, the measured speed, and a feedback gain estimated
from a recorded torque. With D the derivative of the prediction by a nuisance parameter, the solution moves by
-(J'J)^-1 J'D and by a term in the derivatives of the columns. The gain is estimated from the same samples, so
its error is correlated with that of the solution.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from tms_model.bicycle import Array

from tms_fit.least_squares.problem import Problem, ProblemSolution, Whitener
from tms_fit.parameters import shaping
from tms_fit.response.prediction import Predictor, derivative, predictor
from tms_fit.window import Window

CURVE_STEP = 1e-4  # of finite differences by the speed curve's coefficients [m/s, m/s^2, ...]


def nuisance_covariance(
    problem: Problem, solution: ProblemSolution, rows: Whitener, white: float = 0.0
) -> Array:
    """Covariance (p, p) of a solution due to nuisance parameters.

    white [rad/s]: standard deviation of white noise, 0 for another noise model. The correlation between the
    errors of gain and solution is included under white noise; otherwise they count as independent.
    """
    added = np.zeros((len(problem.names), len(problem.names)))
    window = problem.window
    for name, std in (("strike_time", window.delay_std), ("lean_rate_gain", window.lean_rate_gain_std)):
        if not std or name in {*problem.names, *problem.known}:
            continue
        nonlinear = _nonlinear(problem, solution)
        shift = _shift(problem, solution, rows, derivative(window, nonlinear, name))
        variance = std**2
        if name == "lean_rate_gain" and white and window.gain_by_lean_rate is not None:
            # The rows are in units of the noise.
            along = white**2 * rows(np.stack([window.gain_by_lean_rate, np.zeros(len(window.time))], axis=1))
            shared = solution.of_rows @ solution.jacobian[: len(along)].T @ along
            added += np.outer(shift, shared) + np.outer(shared, shift)
            # Least variance of the gain, due to the lean rate alone, for a positive semidefinite sum.
            variance = max(variance, float(along @ along))
        added += np.outer(shift, shift) * variance
    changes = list(_by_curve(problem, solution))
    if changes:
        powers, models = zip(*changes, strict=True)
        shifts = np.stack([_shift(problem, solution, rows, model) for model in models], axis=1)
        added += shifts @ window.speed.covariance[np.ix_(powers, powers)] @ shifts.T
    return added


def nuisance_columns(problem: Problem, solution: ProblemSolution) -> tuple[Array, Array]:
    """Derivatives (n, 2, k) of the prediction by nuisance parameters, and their covariance (k, k).

    Nuisance parameters are the coefficients of the speed curve, and a feedback gain found from a torque.
    """
    window, values = problem.window, problem.values(solution.values)
    changes = list(_by_curve(problem, solution))
    powers = [power for power, _ in changes]
    columns = [model.predict(values) for _, model in changes]
    covariance = window.speed.covariance[np.ix_(powers, powers)]
    if window.lean_rate_gain_std and "lean_rate_gain" not in {*problem.names, *problem.known}:
        columns.append(derivative(window, _nonlinear(problem, solution), "lean_rate_gain").predict(values))
        known, covariance = covariance, np.zeros((len(columns), len(columns)))
        covariance[:-1, :-1], covariance[-1, -1] = known, window.lean_rate_gain_std**2
    return np.stack(columns, axis=2) if columns else np.empty((*window.measured.shape, 0)), covariance


def _by_curve(problem: Problem, solution: ProblemSolution) -> Iterator[tuple[int, Predictor]]:
    """Derivatives of the predictor by the coefficients of the speed curve that the fit uses."""
    window, names = problem.window, {*problem.names, *problem.known}
    if not window.speed.covariance.any():
        return
    nonlinear = _nonlinear(problem, solution)
    for power in range(len(window.speed.coefficients)):
        if (power and "rolling_resistance" in names) or (not power and "speed" in names):
            continue
        ends = [predictor(_moved(window, power, part * CURVE_STEP), nonlinear) for part in (-1.0, 1.0)]
        columns, forced = (
            (getattr(ends[1], part) - getattr(ends[0], part)) / (2.0 * CURVE_STEP)
            for part in ("columns", "forced")
        )
        yield power, Predictor(columns, forced)


def _moved(window: Window, power: int, change: float) -> Window:
    coefficients = window.speed.coefficients.copy()
    coefficients[power] += change
    return replace(window, speed=replace(window.speed, coefficients=coefficients))


def _shift(problem: Problem, solution: ProblemSolution, rows: Whitener, change: Predictor) -> Array:
    """Derivative (p,) of the solution by a nuisance parameter; change: that of the predictor."""
    direct = rows(change.predict(problem.values(solution.values)))
    jacobian = solution.jacobian[: len(direct)]
    moved = -jacobian.T @ direct
    count = len(problem.linear)
    moved[:count] += rows(change.select(problem.linear)).T @ solution.rows[: len(direct)]
    shift: Array = solution.of_rows @ moved
    return shift


def _nonlinear(problem: Problem, solution: ProblemSolution) -> dict[str, float]:
    return shaping(problem.values(solution.values))
