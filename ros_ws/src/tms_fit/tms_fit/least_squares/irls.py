"""Iteratively reweighted least squares over parameters, noise model, robust weights and censored samples."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from tms_model.bicycle import Array

from tms_fit.least_squares.losses import Loss, outlier_count, scale
from tms_fit.least_squares.problem import Problem, ProblemSolution, Whitener, solve
from tms_fit.least_squares.saturated_samples import SaturatedSamples, saturated_samples
from tms_fit.noise import NOISES, Noise, likeliest, oscillator
from tms_fit.noise.ar import is_autocorrelated
from tms_fit.noise.colored import ColoredNoise
from tms_fit.noise.white import White
from tms_fit.parameters import shaping
from tms_fit.response.prediction import derivative
from tms_fit.window import Window

MAX_ITERATIONS = 60
MAX_ROUNDING = 1e-4  # residual relative to the largest rate, below the noise of any gyroscope
TOLERANCE = 1e-4  # last change of the parameters, in standard errors


@dataclass(frozen=True, eq=False)
class Fitted:
    """Solution with its noise model and loss."""

    solution: ProblemSolution  # its inverse is the covariance
    noise: Noise
    noise_model: str  # of NOISES
    loss: str  # of LOSSES, not auto
    outliers: int = 0  # number, where they selected a robust loss


def fit_problem(problem: Problem, noise_model: str, loss: Loss, stated: tuple[float, ...] = ()) -> Fitted:
    """Solution of a problem under a noise model of NOISES, or 'auto': white unless autocorrelated.

    Loss 'auto' is least squares, or Huber's where the residuals hold outliers. stated: known parameters of an
    oscillator: frequency [Hz], decay time [s], standard deviation [rad/s].
    """
    window, known, outliers = problem.window, noise_model, 0
    plain = solution = _plain(problem, noise_model)
    noise = NOISES["white"](window.time, window.measured, np.zeros((*window.measured.shape, 0)))
    limits = saturated_samples(problem)
    informative = limits is None and _exceeds_rounding(problem, solution)
    if loss.name == "auto":
        if informative:
            outliers = outlier_count(window.measured - problem.predicted(solution.values))
        loss = Loss("huber" if outliers else "squares")
    for _ in range(MAX_ITERATIONS):
        if solution.status == "not_observable":
            break
        residual = problem.window.measured - problem.predicted(solution.values)
        fitted = _fitted(problem, solution)
        if known == "auto" and informative and is_autocorrelated(residual):
            known, noise = likeliest(window.time, residual, fitted, stated)
        else:
            known = "white" if known == "auto" else known
            noise = _noise(known, loss, problem, residual, fitted, limits, stated)
        if limits is not None:
            rows = _weighted_by(np.sqrt(limits.information(problem, solution, noise)), noise.rows)
            problem = limits.replaced(problem, solution, noise)
        else:
            rows = _weighted(noise.rows, loss, residual)
        before, start = solution, solution.values[len(problem.linear) :]
        solution = solve(problem, rows, start)
        if _final(problem, known, loss, limits) or _same(before, solution):
            break
    if solution.status != "not_observable":
        solution = _with_covariance(problem, solution, noise, loss, limits)
    if noise_model == "auto" and known == "ar" and loss.name == "squares":
        # Autocorrelated residuals are more often due to a wrong model than to autocorrelated noise, so the
        # values stay those of least squares.
        solution = replace(solution, values=plain.values)
    return Fitted(solution, noise, known, loss.name, outliers)


def _plain(problem: Problem, noise_model: str) -> ProblemSolution:
    """Least squares that starts the iteration; with priors and noise 'auto', under estimated white noise."""
    if noise_model == "auto" and problem.is_informed:
        return fit_problem(problem, "white", Loss("squares")).solution
    return solve(problem, _first_rows(problem))


def _exceeds_rounding(problem: Problem, solution: ProblemSolution) -> bool:
    """Whether residuals exceed rounding, so that a noise model can be estimated from them."""
    if solution.status == "not_observable":
        return False
    measured = problem.window.measured
    return not only_rounding(measured, measured - problem.predicted(solution.values))


def only_rounding(measured: Array, residual: Array) -> bool:
    """Whether residuals (n, 2) of rates (n, 2) are those of a sensor without noise."""
    largest = np.nanmax(np.abs(measured), initial=0.0)
    return bool(np.nanmax(np.abs(residual), initial=0.0) <= MAX_ROUNDING * largest)


def _final(problem: Problem, noise_model: str, loss: Loss, limits: SaturatedSamples | None) -> bool:
    """Whether one iteration is enough, since the weights do not change the solution."""
    if loss.name != "squares" or limits is not None:
        return False
    return not problem.is_informed if noise_model == "white" else not problem.nonlinear


def _first_rows(problem: Problem) -> Whitener:
    good = np.isfinite(problem.window.measured)
    return lambda values: values[good]


def _noise(
    name: str,
    loss: Loss,
    problem: Problem,
    residual: Array,
    fitted: Array,
    limits: SaturatedSamples | None,
    stated: tuple[float, ...],
) -> Noise:
    if name == "white" and loss.name != "squares":
        good = np.isfinite(residual)
        return White(good, scale(residual[good], fitted.shape[2]))
    if name == "oscillator" and stated:
        return oscillator.fit(problem.window.time, residual, fitted, stated)
    noise = NOISES[name](problem.window.time, residual, fitted)
    if limits is not None and isinstance(noise, White):
        return White(noise.good, limits.std(problem, residual, fitted.shape[2], noise.std))
    return noise


def _weighted(rows: Whitener, loss: Loss, residual: Array) -> Whitener:
    """Whitener with rows times the root of their residuals' weights."""
    if loss.name == "squares":
        return rows
    return _weighted_by(np.sqrt(loss.weights(rows(residual))), rows)


def _weighted_by(root: Array, rows: Whitener) -> Whitener:
    return lambda values: _times(root, rows(values))


def _times(factor: Array, rows: Array) -> Array:
    return factor.reshape(-1, *(1,) * (rows.ndim - 1)) * rows


def _with_covariance(
    problem: Problem, solution: ProblemSolution, noise: Noise, loss: Loss, limits: SaturatedSamples | None
) -> ProblemSolution:
    """Solution with the covariance under its noise model, loss and censored samples."""
    residual = problem.window.measured - problem.predicted(solution.values)
    if isinstance(noise, ColoredNoise) and loss.name == "squares":
        return _averaged(problem, solution, noise, residual)
    rows = noise.rows(solution.channels)
    jacobian = solution.jacobian.copy()
    jacobian[: len(rows)] = rows
    if limits is not None and isinstance(noise, White):
        root = np.sqrt(limits.information(problem, solution, noise))
        jacobian[: len(rows)] = _times(root, rows)
    plain = replace(solution, jacobian=jacobian)
    if loss.name == "squares":
        return plain
    return replace(plain, covariance=loss.inflation(noise.rows(residual), len(problem.names)) * plain.of_rows)


def _averaged(
    problem: Problem, solution: ProblemSolution, noise: ColoredNoise, residual: Array
) -> ProblemSolution:
    """Parameters and covariance averaged over the candidates of the noise model."""
    count = len(noise.rows(residual))  # the priors' rows come last
    prior = solution.jacobian[count:], solution.rows[count:]
    shift, covariance = noise.average(residual, solution.channels, prior)
    return replace(solution, values=solution.values + shift, covariance=covariance)


def _fitted(problem: Problem, solution: ProblemSolution) -> Array:
    """Derivatives (n, 2, p) of the prediction by all fitted parameters, including the strike time."""
    values = problem.values(solution.values)
    start = strike_time_slope(problem.window, values, values)
    return (
        solution.channels if start is None else np.concatenate([solution.channels, start[:, :, None]], axis=2)
    )


def strike_time_slope(window: Window, given: Collection[str], values: Mapping[str, float]) -> Array | None:
    """Derivative (n, 2) of the prediction by a strike time estimated beforehand; None where it is exact.

    given: names of free and fixed parameters; values of all parameters.
    """
    if not window.delay_std or "strike_time" in given:
        return None
    return derivative(window, shaping(values), "strike_time").predict(values)


def _same(before: ProblemSolution, after: ProblemSolution) -> bool:
    """Whether two solutions agree to TOLERANCE standard errors."""
    if "not_observable" in (before.status, after.status):
        return True
    std = np.sqrt(np.diag(after.inverse))
    return bool((np.abs(after.values - before.values) <= TOLERANCE * std).all())
