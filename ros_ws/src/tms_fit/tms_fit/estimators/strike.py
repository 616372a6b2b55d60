"""Estimator of a strike as a force of unknown onset, duration and size, and of the free response after it.

The strike is part of the model: its onset, duration, size and kick of the steering, the state of the bicycle
before it and the gyroscopes' biases are always unknown, with stated priors (`tms_fit.impulse.prior`).
Onset and duration are marginalised (`tms_fit.impulse.posterior`). Two quantities have one definition
each, whatever else is unknown:

- `strike_lean_rate`: change of the lean rate that the force alone makes, the first component of M^-1 times
  its time integral;
- `initial_lean_rate`: lean rate at the start of the free response, the first sample after the 97.5 % point of
  the force's end.

A force that acts longer than its equations explain absorbs what a wrong model misses. So where a push leaves
autocorrelated residuals, the force ends no later than the free response was detected to begin.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tms_model import ParameterError, linear_system
from tms_model.bicycle import Array

from tms_fit.estimate import Estimate, Status
from tms_fit.impulse.force import ForcedBicycle
from tms_fit.impulse.posterior import (
    REFINEMENTS,
    UNKNOWNS,
    FreeInformation,
    Hypotheses,
    ImpulsePosterior,
    StrikeSamples,
    coarse_grid,
    evaluate,
    instant,
    refined_grid,
)
from tms_fit.impulse.prior import impulse_prior
from tms_fit.least_squares.irls import Fitted, fit_problem
from tms_fit.least_squares.losses import Loss
from tms_fit.least_squares.make_estimate import make_estimate, too_short
from tms_fit.least_squares.model_selection import ModelSpec, specify_model
from tms_fit.least_squares.nuisance import nuisance_columns
from tms_fit.least_squares.problem import START
from tms_fit.noise import Noise, likeliest
from tms_fit.noise.ar import is_autocorrelated
from tms_fit.noise.white import White
from tms_fit.parameters import BIASES, FRICTION, STRIKE
from tms_fit.response.discretization import as_ridden
from tms_fit.segment import FreeResponse, joined, segment_window
from tms_fit.settings import Settings
from tms_fit.strikes.classification import noise_of
from tms_fit.strikes.strike import NANOSECONDS, Strike
from tms_fit.window import StartInformation, Window, from_sample, without_saturated

REPORTED = (STRIKE[0], "initial_lean_rate", STRIKE[1])  # first among the names of an estimate
AFTER_STRIKE_S = 0.35  # [s] of the free response from which onset and duration are first estimated
MIDDLE_SEARCH_S = 0.06  # on either side of the detected middle of the force
END_QUANTILE = 0.975  # of the posterior of the force's end, after which the free response starts
LEAST_SAMPLES = 5  # before the strike, without which the response is fitted alone
CHANGE_UNKNOWN = 0.5  # [rad/s] of the lean rate, where none was detected
LEAST_NOISE = 1e-5  # [rad/s]
PASSES = 2  # of the fit; the second has the onset, duration and noise model of the first
FIXED_STD = 1e-6  # of a fixed value, SI
SMALLEST_VARIANCE = 1e-14  # of the start's information, relative to the largest


def estimate(window: Window, settings: Settings) -> Estimate:
    """Estimate of a strike and its free response.

    Without `window.force` the strike is an impulse at the window's first sample. No recording makes it raise.
    """
    if FRICTION in {*settings.fixed, *settings.priors, *(settings.free or ())}:
        text = f"{FRICTION}: the estimator strike has no Coulomb friction; use least_squares"
        return Estimate("strike", Status.NOT_OBSERVABLE, text, settings=settings)
    try:
        found = window.force or _instant(window, settings)
    except ParameterError as error:
        return Estimate("strike", Status.NOT_OBSERVABLE, str(error), settings=settings)
    free = _free(window, settings)
    window = replace(window, delay=0.0, delay_std=0.0)
    model = specify_model(window, replace(settings, free=free, priors=_priors(settings, free)))
    if reason := too_short(model.problem):
        return Estimate("strike", Status.TOO_SHORT, reason, settings=settings)
    try:
        return replace(_fit(model, found, settings), settings=settings)
    except np.linalg.LinAlgError:
        text = "the solution lost its precision; give priors or use least_squares"
        return Estimate("strike", Status.NOT_CONVERGED, text, settings=settings)


def _fit(model: ModelSpec, found: ImpulsePosterior, settings: Settings) -> Estimate:
    """Fits of the free response and of the force in turn; each gives the other information on the start."""
    for _ in range(PASSES):
        model = _informed(model, found)
        fitted = fit_problem(model.problem, model.noise, Loss(settings.loss), settings.oscillator)
        single = make_estimate("strike", model, fitted, settings)
        if single.status is not Status.OK:
            return single
        found = _posterior(found, model, fitted)
    return _averaged(single, model, fitted, found)


def with_force(window: Window, response: FreeResponse, settings: Settings) -> Window:
    """Window with the force of its strike by the samples around it, from the first sample after the force on.

    The window is unchanged where there are too few samples before, and where a known steer torque is an
    input, whose effect on them is not removed.
    """
    if response.before is None or window.steer_torque is not None:
        return window
    try:
        whole = segment_window(joined(response.before, response.segment), window.bicycle, settings)
        samples = _strike_samples(window, response.strike.change, settings)
    except ParameterError:
        return window
    count = len(whole.time) - len(window.time)
    early = window.time <= AFTER_STRIKE_S
    if count < LEAST_SAMPLES or early.sum() < LEAST_SAMPLES:
        return window
    # The yaw rate as levelled by the lean angle that was reached before the window.
    window = replace(window, yaw_rate=whole.yaw_rate[count:])
    time = whole.time - whole.time[count]
    used = np.concatenate([np.ones(count, dtype=bool), early])
    around = replace(samples, time=time[used], rates=without_saturated(whole).measured[used])
    try:
        found = _date(around, response.strike, window.first_ns)
    except np.linalg.LinAlgError:
        return window
    start = int(np.searchsorted(window.time, found.quantile(found.hypotheses.end, END_QUANTILE)))
    if not start < len(window.time):
        return window
    shift = float(window.time[start])
    before = around.time < shift
    samples = replace(samples, time=around.time[before] - shift, rates=around.rates[before])
    return replace(from_sample(window, start), force=found.seen_from(shift, samples))


def _date(around: StrikeSamples, strike: Strike, first_ns: int) -> ImpulsePosterior:
    """Posterior of the force of a strike by samples around it; times count from first_ns."""
    time = around.time
    noise: Noise = rough_noise(around.rates)
    middle = (strike.end_ns - first_ns) / NANOSECONDS - 0.5 * strike.rise
    reach = max(MIDDLE_SEARCH_S, 0.5 * strike.rise)
    spacing = float(np.median(np.diff(time)))
    grid = coarse_grid(middle - reach, min(middle + reach, float(time[-1])), spacing)
    found = evaluate(around, grid, noise.rows)
    for _ in range(REFINEMENTS):
        found = evaluate(around, refined_grid(found), noise.rows)
    residual = around.rates - found.predicted(found.best)
    if is_autocorrelated(residual):
        _, noise = likeliest(time, residual, np.zeros((*residual.shape, 0)))
        latest = (strike.time_ns - first_ns) / NANOSECONDS if strike.kind == "push" else np.inf
        for _ in range(REFINEMENTS):
            found = evaluate(around, refined_grid(found).ending_by(latest), noise.rows)
    return found


def _instant(window: Window, settings: Settings) -> ImpulsePosterior:
    """An impulse at the window's first sample, of any size."""
    samples = _strike_samples(window, CHANGE_UNKNOWN, settings)
    return evaluate(samples, instant(0.0), rough_noise(samples.rates).rows)


def _free(window: Window, settings: Settings) -> tuple[str, ...]:
    """Unknowns of the free response: always its start and the biases, and what the settings free."""
    absent = [b for b, rate in zip(BIASES, window.measured.T, strict=True) if not np.isfinite(rate).any()]
    known = {*absent, *settings.fixed}
    own = replace(settings, free=None, priors={n: p for n, p in settings.priors.items() if n not in START})
    others = (*(settings.free or ()), *specify_model(window, own).free)
    return tuple(dict.fromkeys(name for name in (*START, *others) if name not in known))


def _priors(settings: Settings, free: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    """Priors of the free response's unknowns; those of biases are in what the strike says about the start."""
    return {name: one for name, one in settings.priors.items() if name in free and name not in BIASES}


def _strike_samples(window: Window, change: float, settings: Settings) -> StrikeSamples:
    """Model of a strike that changes the lean rate by about `change` [rad/s], with one missing sample."""
    fixed = settings.fixed
    gain = fixed.get("lean_rate_gain", window.lean_rate_gain)
    bicycle = as_ridden(window.bicycle, gain, fixed.get("steer_damper", 0.0))
    model = ForcedBicycle(
        linear_system(bicycle, float(window.speed.at(0.0))), fixed.get("mounting_pitch", 0.0)
    )
    missing = np.full((1, 2), np.nan)
    return StrikeSamples(model, np.zeros(1), missing, impulse_prior(window.bicycle, settings, change))


def rough_noise(rates: Array) -> White:
    """White noise of rates (n, 2), from differences of neighbours."""
    each = [noise_of(rate[np.isfinite(rate)]) for rate in rates.T]
    return White(np.isfinite(rates), max(*each, LEAST_NOISE))


def _with_floor(noise: Noise) -> Noise:
    """Noise of at least LEAST_NOISE, if it is white: without any, the information has no true digits."""
    return White(noise.good, max(noise.std, LEAST_NOISE)) if isinstance(noise, White) else noise


def _informed(model: ModelSpec, found: ImpulsePosterior) -> ModelSpec:
    """Model with information on its start by the samples before it and priors, at the likeliest onset."""
    samples, one = found.samples, found.hypotheses.rows(np.array([found.best]))
    mean, covariance = evaluate(samples, one, rough_noise(samples.rates).rows).conditional(0, 0.0)
    mean, covariance = mean[:UNKNOWNS], covariance[:UNKNOWNS, :UNKNOWNS]
    scale = np.sqrt(np.diag(covariance))
    sizes, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    rows = (vectors / np.sqrt(np.maximum(sizes, SMALLEST_VARIANCE * sizes[-1]))).T / scale
    window = replace(model.problem.window, start=StartInformation(rows, rows @ mean))
    return replace(model, problem=replace(model.problem, window=window))


def _posterior(found: ImpulsePosterior, model: ModelSpec, fitted: Fitted) -> ImpulsePosterior:
    """Posterior from the samples before the start and the fit of the free response."""
    samples = found.samples
    noise = _with_floor(fitted.noise).at_samples(samples.time, np.isfinite(samples.rates))
    grid: Hypotheses = found.hypotheses
    if len(grid.onset) > 1:
        grid = refined_grid(found).ending_by(0.0)
    return evaluate(samples, grid, noise.rows, _information(model, fitted))


def _information(model: ModelSpec, fitted: Fitted) -> FreeInformation:
    """Information of a window's samples, and of priors and fixed values, around the solution.

    Nuisance parameters (the speed curve, a gain found from a torque) are further unknowns.
    """
    problem, solution = model.problem, fitted.solution
    names = (*START, *(name for name in problem.names if name not in START))
    residual = problem.window.measured - problem.predicted(solution.values)
    nuisance, spread = nuisance_columns(problem, solution)
    columns = np.zeros((*residual.shape, len(names) + len(spread)))
    for column, name in enumerate(problem.names):
        columns[:, :, names.index(name)] = solution.channels[:, :, column]
    columns[:, :, len(names) :] = nuisance
    noise = _with_floor(fitted.noise)
    rows, off = noise.rows(columns), noise.rows(residual)
    values = problem.values(solution.values)
    at = np.array([*(values.get(name, 0.0) for name in names), *np.zeros(len(spread))])
    matrix, vector = rows.T @ rows, rows.T @ (off + rows @ at)
    for place, name in enumerate(names):
        mean, std = problem.priors.get(name, (0.0, np.inf))
        if name in problem.known:
            mean, std = problem.known[name], FIXED_STD
        matrix[place, place] += std**-2
        vector[place] += mean * std**-2
    matrix[len(names) :, len(names) :] += np.linalg.pinv(spread)
    return FreeInformation(0.0, matrix, vector)


def _averaged(single: Estimate, model: ModelSpec, fitted: Fitted, found: ImpulsePosterior) -> Estimate:
    """The estimate with the strike's unknowns, averaged over onset and duration of the force."""
    problem, solution = model.problem, fitted.solution
    others = [name for name in problem.names if name not in START]
    every = (*START, *STRIKE, *others)
    mean, covariance = found.at(0.0)
    first = [name for name in REPORTED if name in (*problem.names, *STRIKE)]
    names = (*first, *(name for name in problem.names if name not in first))
    index = [every.index(name) for name in names]
    values, spread = mean[index], covariance[np.ix_(index, index)]
    shared = [names.index(name) for name in problem.names]
    spread[np.ix_(shared, shared)] += _other_noise(fitted)
    jacobian = np.zeros((*single.jacobian.shape[:2], len(names)))
    jacobian[:, :, shared] = single.jacobian
    predicted = single.predicted + single.jacobian @ (values[shared] - solution.values)
    residual = single.residual + single.predicted - predicted
    return replace(
        single,
        message=f"strike as a force of unknown onset and duration, {single.message}",
        names=names,
        values=values,
        covariance=spread,
        jacobian=jacobian,
        predicted=predicted,
        residual=residual,
        whitened=fitted.noise.innovations(residual),
    )


def _other_noise(fitted: Fitted) -> Array:
    """Covariance (p, p) by noise models beside the one of largest weight."""
    solution = fitted.solution
    samples = fitted.noise.rows(solution.channels)
    rows = np.concatenate([samples, solution.jacobian[len(samples) :]])
    sizes, vectors = np.linalg.eigh(solution.inverse - replace(solution, jacobian=rows).of_rows)
    found: Array = (vectors * np.maximum(sizes, 0.0)) @ vectors.T
    return found
