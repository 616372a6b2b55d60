"""Least squares of a free response, by variable projection.

The response of Eq. (3.1) is linear in the initial states and the biases; speed, rolling resistance, the
strike's instant, a feedback gain and the sensor's pitch shape it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from tms_fit.estimate import Estimate, Status
from tms_fit.least_squares.irls import fit_problem
from tms_fit.least_squares.losses import Loss
from tms_fit.least_squares.make_estimate import answer, in_order, too_short
from tms_fit.least_squares.model_selection import (
    ModelSpec,
    at_found,
    choose,
    decelerating,
    unsteady,
    without_resistance,
)
from tms_fit.noise.ar import is_autocorrelated
from tms_fit.settings import Settings
from tms_fit.window import Window

OF = "initial_lean_rate"
ROUNDED = 1e-9 / math.sqrt(12.0)  # [s], deviation of an instant that is a whole nanosecond
PLACES = 401  # of an instant between two samples
CERTAIN = 20.0  # by which what nobody asked for must lower BIC to be believed


def fit_window(window: Window, settings: Settings) -> Estimate:
    """Best-fitting free parameters of a window; the message says what `settings` left open.

    Never raises for what a recording holds: an answer that can't be given is one with another status.
    """
    choice, estimate = decide(window, settings)
    return in_order(estimate, choice.free)


def decide(window: Window, settings: Settings) -> tuple[ModelSpec, Estimate]:
    """What is to be found, where `settings` leave it open, and the estimate of it."""
    choice = choose(window, settings)
    if choice.coasting:
        return _coasting(choice, settings)
    estimate = fit_model("least_squares", choice, settings)
    falling = decelerating(choice, settings)
    if falling is not None and estimate.status == "ok":
        other = fit_model("least_squares", falling, settings)
        if other.status == "ok" and other.bic < estimate.bic - CERTAIN:
            choice, estimate = falling, other
    if estimate.status == "ok" and estimate.noise_model != "white":
        return _unsteady(choice, estimate, settings)
    return choice, estimate


def _coasting(choice: ModelSpec, settings: Settings) -> tuple[ModelSpec, Estimate]:
    """The same where a rolling resistance is found that nobody asked for.

    Starts are compared at the resistance that each has under white noise: under noise that is found with it,
    the search goes slowly where the start is wrong.
    """
    narrow = fit_model("least_squares", replace(choice, noise="white"), settings)
    found = choice
    for rival in unsteady(choice, settings) if settings.noise != "white" else []:
        wide = fit_model("least_squares", replace(rival, noise="white"), settings)
        if not (narrow.status == wide.status == "ok" and is_autocorrelated(narrow.residual)):
            continue
        here, there = (
            _bic(at_found(one, fit), "ar", settings) for one, fit in ((choice, narrow), (rival, wide))
        )
        if wide.bic < narrow.bic - CERTAIN and there < here - CERTAIN:
            found = rival
    estimate = fit_model("least_squares", found, settings)
    if estimate.status == "ok":
        constant = without_resistance(found, settings)
        estimate = _instead(estimate, choice.coasting, fit_model("least_squares", constant, settings))
        if found is not choice:
            estimate = _instead(estimate, found.reasons[-1], narrow)
    return found, estimate


def _unsteady(choice: ModelSpec, estimate: Estimate, settings: Settings) -> tuple[ModelSpec, Estimate]:
    """A start that is not upright and straight, if residuals that are alike speak for it beyond doubt.

    All hypotheses are compared under autoregressive noise, which the narrowest might need as well. The widest
    must first win under white noise, which is quickly seen and favours it.
    """
    rivals = unsteady(choice, settings)
    if not rivals or not _bic(rivals[-1], "white", settings) < _bic(choice, "white", settings) - CERTAIN:
        return choice, estimate
    least = _bic(choice, "ar", settings) - CERTAIN
    found: ModelSpec | None = None
    for rival in rivals:
        bic = _bic(rival, "ar", settings)
        if bic < least:
            found, least = rival, bic
    if found is None:
        return choice, estimate
    answer = fit_model("least_squares", found, settings)
    if answer.status != "ok":
        return choice, estimate
    return found, _instead(answer, found.reasons[-1], estimate)


def _instead(estimate: Estimate, why: str, other: Estimate) -> Estimate:
    """The estimate; beside why something was chosen stands what the initial lean rate would be otherwise."""
    if other.status != "ok" or OF not in other.names:
        return estimate
    told = f"{why}; else the initial lean rate would be {other.parameters[OF]:+.3f} rad/s"
    return replace(estimate, chosen=tuple(told if one == why else one for one in estimate.chosen))


def _bic(choice: ModelSpec, noise: str, settings: Settings) -> float:
    """BIC under a noise model, infinite where there is no answer."""
    found = fit_model("least_squares", replace(choice, noise=noise), settings)
    return found.bic if found.status == "ok" else math.inf


def fit_model(name: str, choice: ModelSpec, settings: Settings) -> Estimate:
    """The estimate for what was chosen, under an estimator's name."""
    reason = too_short(choice.problem)
    if reason:
        return Estimate(name, Status.TOO_SHORT, reason, settings=settings)
    fitted = fit_problem(choice.problem, choice.noise, Loss(settings.loss), settings.oscillator)
    return answer(name, choice, fitted, settings)


def refine_start(window: Window, settings: Settings, longest_delay: float) -> Window:
    """The window with the strike's instant between two samples estimated.

    The delay [s] lies between 0 and `longest_delay`, anywhere with the same probability before the response
    is seen; it is dated by the unknowns that the response asks for. A start that is upright and straight and
    one that isn't differ most in the first samples, so that an instant found with the wrong one is wrong.
    """
    window = replace(window, longest_delay=longest_delay)
    first = choose(window, settings)
    window = _dated(window, first, settings)
    decided, _ = decide(window, settings)
    return window if decided.free == first.free else _dated(window, decided, settings)


def _dated(window: Window, choice: ModelSpec, settings: Settings) -> Window:
    """The window with the mean and the deviation of the instant, given the response.

    Least squares leaves a normal distribution, which ends at the two samples: at one of them neither its peak
    nor its width is an instant and its deviation.
    """
    problem, longest = choice.problem, window.longest_delay
    if "strike_time" in {*problem.names, *problem.known} or too_short(problem):
        return window
    joint = replace(problem, nonlinear=(*problem.nonlinear, "strike_time"))
    solution = fit_problem(joint, choice.noise, Loss(settings.loss), settings.oscillator).solution
    mean, std = 0.5 * longest, longest / math.sqrt(12.0)  # as where the response tells nothing
    if solution.status == "ok":
        beyond = solution.of_rows[-1] @ solution.jacobian.T @ solution.rows  # not 0 at an end
        peak, spread = -float(solution.values[-1] + beyond), math.sqrt(float(solution.inverse[-1, -1]))
        mean, std = within(peak, spread, longest)
    return replace(window, delay=round(mean, 9), delay_std=math.hypot(std, ROUNDED))


def within(peak: float, spread: float, longest: float) -> tuple[float, float]:
    """Mean and deviation of a normal distribution of which only what lies between 0 and `longest` counts."""
    near = min(max(peak, 0.0), longest)
    if not spread > 0.0:
        return near, 0.0
    # as far from the likeliest place as the density isn't e^-50 of what it is there
    outside = abs(peak - near)
    reach = 100.0 * spread**2 / (math.sqrt(outside**2 + 100.0 * spread**2) + outside)
    places = np.linspace(max(near - reach, 0.0), min(near + reach, longest), PLACES)
    weight = np.exp(-0.5 * (places - near) * (places + near - 2.0 * peak) / spread**2)
    weight[[0, -1]] *= 0.5
    mean = float(weight @ places / weight.sum())
    return mean, math.sqrt(float(weight @ (places - mean) ** 2 / weight.sum()))
