"""Estimates from solutions: uncertainty, goodness of fit, likelihood and message."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from tms_model.bicycle import Array

from tms_fit.estimate import Estimate, Status
from tms_fit.least_squares.censoring import log_probability
from tms_fit.least_squares.irls import Fitted
from tms_fit.least_squares.model_selection import ModelSpec
from tms_fit.least_squares.nuisance import nuisance_covariance
from tms_fit.least_squares.problem import Problem, ProblemSolution
from tms_fit.noise import Noise
from tms_fit.noise.white import White
from tms_fit.parameters import CHANNELS, shaping
from tms_fit.response.discretization import known_values, speeds_at
from tms_fit.settings import Settings
from tms_fit.window import Window, without_saturated

MIN_SPARE_SAMPLES = 10  # scalar measurements beyond the number of unknowns
MIN_SPAN_S = 0.25  # [s]
AUTOCORRELATION_WARNING = 0.3  # of the residuals at lag one, above which an interval is too narrow


def make_estimate(name: str, model: ModelSpec, fitted: Fitted, settings: Settings) -> Estimate:
    """Estimate of a solved model, under an estimator's name.

    The covariance includes the uncertainty of the speed and of the strike time between two samples, where the
    window states them.
    """
    problem, solution, noise = model.problem, fitted.solution, fitted.noise
    if solution.status == "not_observable":
        return Estimate(name, Status(solution.status.value), solution.message, settings=settings)
    covariance = solution.inverse
    if not (np.isfinite(solution.values).all() and (np.diag(covariance) > 0.0).all()):
        text = "the solution lost its precision; free fewer parameters"
        return Estimate(name, Status.NOT_CONVERGED, text, settings=settings)
    window = problem.window
    white = noise.std if isinstance(noise, White) else 0.0
    covariance = covariance + nuisance_covariance(problem, solution, noise.rows, white)
    predicted = problem.predicted(solution.values)
    free = without_saturated(window)  # a censored sample has no residual
    residual = free.measured - predicted
    innovations = noise.innovations(residual)
    autocorrelation = lag_one_autocorrelation(innovations)
    degrees, count = degrees_of_freedom(problem), int(np.isfinite(window.measured).sum())
    seen = degrees - (count - int(np.isfinite(residual).sum()))
    text = _message(model, fitted, settings, autocorrelation)
    return Estimate(
        estimator=name,
        status=Status(solution.status.value),
        message=text if solution.status == "ok" else f"{text}; {solution.message}",
        names=problem.names,
        values=solution.values,
        covariance=covariance,
        degrees_of_freedom=degrees,
        residual_std=math.sqrt(float(np.nansum(residual**2)) / max(seen, 1)),
        vaf=variance_accounted_for(free, predicted),
        sample_count=count,
        residual_autocorrelation=autocorrelation,
        known={**_known(problem, solution), **problem.known},
        predicted=predicted,
        residual=residual,
        whitened=innovations,
        jacobian=solution.channels,
        noise=noise.parameters,
        noise_model=fitted.noise_model,
        loss=fitted.loss,
        chosen=(*model.reasons, *_reasons(fitted, settings)),
        log_likelihood=_log_likelihood(noise, window, predicted),
        unknown_count=len(problem.names) + len(noise.parameters),
        settings=settings,
    )


def in_order(estimate: Estimate, names: tuple[str, ...]) -> Estimate:
    """Estimate with its parameters in the order of `names`."""
    if estimate.names in (names, ()):
        return estimate
    index = [estimate.names.index(name) for name in names]
    return replace(
        estimate,
        names=names,
        values=estimate.values[index],
        covariance=estimate.covariance[np.ix_(index, index)],
        jacobian=estimate.jacobian[:, :, index],
    )


def degrees_of_freedom(problem: Problem) -> int:
    """Number of measurements and priors minus number of unknowns."""
    start = problem.window.start
    count = int(np.isfinite(problem.window.measured).sum()) + len(problem.priors)
    count += 0 if start is None else len(start.rows)
    between = problem.window.delay_std and "strike_time" not in problem.names
    return count - len(problem.names) - (1 if between else 0)


def too_short(problem: Problem) -> str:
    """Reason why a window is too short for its unknowns, or an empty text."""
    window, unknowns = problem.window, len(problem.names)
    count = int(np.isfinite(window.measured).sum())
    span = float(window.time[-1]) if len(window.time) else 0.0
    if span < MIN_SPAN_S or count < unknowns + MIN_SPARE_SAMPLES:
        return (
            f"expected at least {MIN_SPAN_S} s and {unknowns + MIN_SPARE_SAMPLES} measurements after the"
            f" strike for {unknowns} unknowns, found {span:.3f} s and {count}"
        )
    return ""


def variance_accounted_for(window: Window, predicted: Array) -> dict[str, float]:
    """VAF = 1 - var(measured - predicted) / var(measured) for each channel that was measured."""
    found = {}
    for channel, measured, model in zip(CHANNELS, window.measured.T, predicted.T, strict=True):
        good = np.isfinite(measured)
        if good.sum() > 1 and np.var(measured[good]) > 0.0:
            found[channel] = float(1.0 - np.var(measured[good] - model[good]) / np.var(measured[good]))
    return found


def lag_one_autocorrelation(residual: Array) -> float:
    """Lag-one autocorrelation of residuals (n, 2), the largest of the channels; near 0 for white noise."""
    worst = float("nan")
    for channel in residual.T:
        good = channel[np.isfinite(channel)]
        if len(good) > 2 and np.ptp(good) > 0.0:
            centred = good - good.mean()
            worst = float(np.fmax(worst, centred[1:] @ centred[:-1] / (centred @ centred)))
    return worst


def _log_likelihood(noise: Noise, window: Window, predicted: Array) -> float:
    """Log-likelihood of the samples at the solution, maximised over the noise variance."""
    if window.saturated is not None and isinstance(noise, White):
        return _censored_log_likelihood(noise.std, window, predicted)
    residual = window.measured - predicted
    rows = noise.rows(residual)
    count = int(np.isfinite(residual).sum())
    squares = float(rows @ rows)
    if not squares > 0.0:
        return math.inf
    return -0.5 * (
        count * (math.log(2.0 * math.pi) + 1.0 + math.log(squares / count)) + noise.log_determinant
    )


def _censored_log_likelihood(std: float, window: Window, predicted: Array) -> float:
    """Tobit log-likelihood; a saturated sample adds the probability of a rate beyond its limit."""
    assert window.saturated is not None
    at_limit = window.saturated != 0.0
    u = ((window.measured - predicted) / std)[~at_limit & np.isfinite(window.measured)]
    beyond = log_probability(window.measured[at_limit], window.saturated[at_limit], predicted[at_limit], std)
    return float(np.sum(-0.5 * u**2 - 0.5 * math.log(2.0 * math.pi) - math.log(std)) + np.sum(beyond))


def _known(problem: Problem, solution: ProblemSolution) -> dict[str, float]:
    """Values of the parameters that were not free, as the prediction used them."""
    known, values = known_values(problem.window), shaping(problem.values(solution.values))
    start = values.get("strike_time", known["strike_time"])
    known["speed"] = float(speeds_at(problem.window, values, np.array([start]))[0])
    return {name: value for name, value in known.items() if name not in problem.names}


def _message(model: ModelSpec, fitted: Fitted, settings: Settings, autocorrelation: float) -> str:
    """The message: method, data, selections and warnings."""
    window = model.problem.window
    method = "least squares" if model.problem.nonlinear else "linear least squares"
    if fitted.loss != "squares":
        method = {"huber": "Huber's loss", "student_t": "Student's t loss"}[fitted.loss]
    used = " and ".join(_measured_channels(window))
    text = f"{method} on {used} over {window.time[-1]:.2f} s{model.words}"
    reasons = _reasons(fitted, settings)
    if fitted.noise_model != "white" and settings.noise != "auto":
        reasons = (*reasons, f"the noise is taken as {_kind(fitted)}, and the interval with it")
    text = "; ".join((text, *reasons))
    if fitted.noise_model == "white" and autocorrelation > AUTOCORRELATION_WARNING:
        text += (
            f"; neighbouring residuals are alike (autocorrelation {autocorrelation:.2f}): the model misses"
            " something and the interval is too narrow"
        )
    return text


def _reasons(fitted: Fitted, settings: Settings) -> tuple[str, ...]:
    """Selections of loss and noise model by the residuals, a phrase each."""
    reasons = []
    if fitted.outliers:
        few = "1 sample stands" if fitted.outliers == 1 else f"{fitted.outliers} samples stand"
        reasons.append(f"{few} apart from the neighbours, so outliers count less")
    if fitted.noise_model != "white" and settings.noise == "auto":
        reasons.append(
            f"neighbouring residuals are alike, so the noise is taken as {_kind(fitted)}, and the interval"
            " with it"
        )
    return tuple(reasons)


def _kind(fitted: Fitted) -> str:
    if fitted.noise_model == "ar":
        return "autoregressive"
    noise = fitted.noise.parameters
    found = [f"{value:.1f} Hz" for name, value in noise.items() if name.endswith("_frequency")]
    return f"white with an oscillation of {' and '.join(found)}" if found else "white, no oscillation found"


def _measured_channels(window: Window) -> list[str]:
    """Names, in words, of the channels that hold data."""
    return [
        channel.replace("_", " ")
        for channel, values in zip(CHANNELS, window.measured.T, strict=True)
        if np.isfinite(values).any()
    ]
