"""Least-squares estimator of a free response by variable projection, with model selection.

The response of Eq. (3.1) is linear in the initial states and the biases, and nonlinear in speed, rolling
resistance, strike time, feedback gain and mounting pitch of the sensor.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from tms_fit.estimate import Estimate, Status
from tms_fit.least_squares.irls import fit_problem
from tms_fit.least_squares.losses import Loss
from tms_fit.least_squares.make_estimate import in_order, make_estimate, too_short
from tms_fit.least_squares.model_selection import (
    ModelSpec,
    at_measured_speed,
    specify_model,
    with_disturbed_start,
    with_falling_speed,
    with_nonlinear_fixed,
)
from tms_fit.noise.ar import is_autocorrelated
from tms_fit.settings import Settings
from tms_fit.window import Window

LEAN_RATE = "initial_lean_rate"
ROUNDING_STD_S = 1e-9 / math.sqrt(12.0)  # of a time rounded to whole nanoseconds
GRID_SIZE = 401  # points of the truncated distribution
BIC_MARGIN = 20.0  # decrease of BIC required to free a parameter by default


def fit_window(window: Window, settings: Settings) -> Estimate:
    """Estimate of the free parameters of a window; its message names the selections of the model.

    No recording makes it raise: an estimate without values has another status than ok.
    """
    model, estimate = select_model(window, settings)
    return in_order(estimate, model.free)


def select_model(window: Window, settings: Settings) -> tuple[ModelSpec, Estimate]:
    """Model, selected by evidence where `settings` leave it open, and its estimate."""
    model = specify_model(window, settings)
    if model.coasting:
        return _select_coasting(model, settings)
    estimate = fit_model("least_squares", model, settings)
    falling = with_falling_speed(model, settings)
    if falling is not None and estimate.status == "ok":
        other = fit_model("least_squares", falling, settings)
        if other.status == "ok" and other.bic < estimate.bic - BIC_MARGIN:
            model, estimate = falling, other
    if estimate.status == "ok" and estimate.noise_model != "white":
        return _select_disturbed_start(model, estimate, settings)
    return model, estimate


def _select_coasting(model: ModelSpec, settings: Settings) -> tuple[ModelSpec, Estimate]:
    """Model and its estimate where the rolling resistance is freed by default.

    Models of the initial state are compared at the resistance that each has under white noise: with free
    autoregressive noise the minimisation converges slowly for a wrong model.
    """
    narrow = fit_model("least_squares", replace(model, noise="white"), settings)
    found = model
    for rival in with_disturbed_start(model, settings) if settings.noise != "white" else []:
        wide = fit_model("least_squares", replace(rival, noise="white"), settings)
        if not (narrow.status == wide.status == "ok" and is_autocorrelated(narrow.residual)):
            continue
        here, there = (
            _bic(with_nonlinear_fixed(one, fit), "ar", settings)
            for one, fit in ((model, narrow), (rival, wide))
        )
        if wide.bic < narrow.bic - BIC_MARGIN and there < here - BIC_MARGIN:
            found = rival
    estimate = fit_model("least_squares", found, settings)
    if estimate.status == "ok":
        constant = at_measured_speed(found, settings)
        estimate = _with_alternative(estimate, model.coasting, fit_model("least_squares", constant, settings))
        if found is not model:
            estimate = _with_alternative(estimate, found.reasons[-1], narrow)
    return found, estimate


def _select_disturbed_start(
    model: ModelSpec, estimate: Estimate, settings: Settings
) -> tuple[ModelSpec, Estimate]:
    """Model with a disturbed initial state where it clearly lowers BIC, else the given one, and its estimate.

    All models are compared under autoregressive noise, which the smallest model may require. The largest must
    first win under white noise, which is fast to compute and favours it.
    """
    rivals = with_disturbed_start(model, settings)
    if not rivals or not _bic(rivals[-1], "white", settings) < _bic(model, "white", settings) - BIC_MARGIN:
        return model, estimate
    least = _bic(model, "ar", settings) - BIC_MARGIN
    found: ModelSpec | None = None
    for rival in rivals:
        bic = _bic(rival, "ar", settings)
        if bic < least:
            found, least = rival, bic
    if found is None:
        return model, estimate
    wide = fit_model("least_squares", found, settings)
    if wide.status != "ok":
        return model, estimate
    return found, _with_alternative(wide, found.reasons[-1], estimate)


def _with_alternative(estimate: Estimate, why: str, other: Estimate) -> Estimate:
    """Estimate with the initial lean rate of the other model added to the reason of the selection."""
    if other.status != "ok" or LEAN_RATE not in other:
        return estimate
    text = f"{why}; else the initial lean rate would be {other[LEAN_RATE].value:+.3f} rad/s"
    return replace(estimate, chosen=tuple(text if one == why else one for one in estimate.chosen))


def _bic(model: ModelSpec, noise: str, settings: Settings) -> float:
    """BIC under a noise model, infinite where there is no estimate."""
    found = fit_model("least_squares", replace(model, noise=noise), settings)
    return found.bic if found.status == "ok" else math.inf


def fit_model(name: str, model: ModelSpec, settings: Settings) -> Estimate:
    """Estimate of a model, under an estimator's name."""
    reason = too_short(model.problem)
    if reason:
        return Estimate(name, Status.TOO_SHORT, reason, settings=settings)
    fitted = fit_problem(model.problem, model.noise, Loss(settings.loss), settings.oscillator)
    return make_estimate(name, model, fitted, settings)


def refine_start(window: Window, settings: Settings, longest_delay: float) -> Window:
    """Window with the strike time between two samples estimated.

    The delay [s] has a uniform prior between 0 and `longest_delay`. It is estimated with the free parameters
    of the selected model: models of the initial state differ most in the first samples, so a wrong one biases
    the strike time.
    """
    window = replace(window, longest_delay=longest_delay)
    first = specify_model(window, settings)
    window = _with_strike_time(window, first, settings)
    selected, _ = select_model(window, settings)
    return window if selected.free == first.free else _with_strike_time(window, selected, settings)


def _with_strike_time(window: Window, model: ModelSpec, settings: Settings) -> Window:
    """Window with posterior mean and standard deviation of the strike time.

    The posterior is a normal distribution, truncated at the two samples: near a sample its mode and width are
    not the mean and standard deviation.
    """
    problem, longest = model.problem, window.longest_delay
    if "strike_time" in {*problem.names, *problem.known} or too_short(problem):
        return window
    joint = replace(problem, nonlinear=(*problem.nonlinear, "strike_time"))
    solution = fit_problem(joint, model.noise, Loss(settings.loss), settings.oscillator).solution
    mean, std = 0.5 * longest, longest / math.sqrt(12.0)  # uniform: without information in the response
    if solution.status == "ok":
        beyond = solution.of_rows[-1] @ solution.jacobian.T @ solution.rows  # not 0 at an end
        peak, spread = -float(solution.values[-1] + beyond), math.sqrt(float(solution.inverse[-1, -1]))
        mean, std = truncated_normal(peak, spread, longest)
    return replace(window, delay=round(mean, 9), delay_std=math.hypot(std, ROUNDING_STD_S))


def truncated_normal(peak: float, spread: float, longest: float) -> tuple[float, float]:
    """Mean and standard deviation of a normal distribution truncated to 0 ... `longest`."""
    near = min(max(peak, 0.0), longest)
    if not spread > 0.0:
        return near, 0.0
    # the grid ends where the density has fallen to e^-50 of its maximum
    outside = abs(peak - near)
    reach = 100.0 * spread**2 / (math.sqrt(outside**2 + 100.0 * spread**2) + outside)
    places = np.linspace(max(near - reach, 0.0), min(near + reach, longest), GRID_SIZE)
    weight = np.exp(-0.5 * (places - near) * (places + near - 2.0 * peak) / spread**2)
    weight[[0, -1]] *= 0.5
    mean = float(weight @ places / weight.sum())
    return mean, math.sqrt(float(weight @ (places - mean) ** 2 / weight.sum()))
