"""Least squares of a free response, by variable projection.

The response of Eq. (3.1) is linear in the initial states and the biases; speed, rolling resistance, the
strike's instant, a feedback gain and the sensor's pitch shape it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from tms_model.bicycle import Array

from tms_fit.answer import answer, in_order, too_short
from tms_fit.choices import Choice, choose
from tms_fit.estimate import Estimate
from tms_fit.noise import NOISES, Noise
from tms_fit.prediction import derivative
from tms_fit.projection import Problem, Solution, solve
from tms_fit.settings import NONLINEAR, FitSettings
from tms_fit.window import Window

ROUNDS = 20  # at most, of noise and parameters in turn
SETTLED = 1e-3  # change of the parameters, in standard errors, that ends the rounds


def fit_window(window: Window, settings: FitSettings) -> Estimate:
    """Best-fitting free parameters of a window; the message says what `settings` left open.

    Never raises for what a recording holds: an answer that can't be given is one with another status.
    """
    choice = choose(window, settings)
    return in_order(fit_choice("least_squares", choice, settings), choice.free)


def fit_choice(name: str, choice: Choice, settings: FitSettings) -> Estimate:
    """The estimate for what was chosen, under an estimator's name."""
    reason = too_short(choice.problem)
    if reason:
        return Estimate(name, "too_short", reason, settings=settings)
    solution, noise = solve_with_noise(choice.problem)
    words = "linear least squares" if not choice.problem.nonlinear else "least squares"
    return answer(name, words + choice.words, choice.problem, solution, noise, "white", settings)


def solve_with_noise(problem: Problem) -> tuple[Solution, Noise]:
    """Parameters and noise, each in the light of the other."""
    model = NOISES["white"]
    empty = np.zeros((*problem.window.measured.shape, len(problem.names)))
    noise = model(problem.window.measured, empty)
    solution = solve(problem, noise.rows)
    for _ in range(ROUNDS):
        if solution.status == "not_observable":
            break
        residual = problem.window.measured - problem.predicted(solution.values)
        before, noise = solution, model(residual, _fitted(problem, solution))
        solution = solve(problem, noise.rows, before.values[len(problem.linear) :])
        if not problem.priors or _same(before, solution):
            break
    return solution, noise


def _fitted(problem: Problem, solution: Solution) -> Array:
    """Derivatives (n, 2, p) of the prediction by all that was fitted, the start found beforehand too."""
    if not problem.window.delay_std or "strike_time" in {*problem.names, *problem.known}:
        return solution.channels
    values = problem.values(solution.values)
    nonlinear = {name: value for name, value in values.items() if name in NONLINEAR}
    by_start = derivative(problem.window, nonlinear, "strike_time").predict(values)
    return np.concatenate([solution.channels, by_start[:, :, None]], axis=2)


def _same(before: Solution, after: Solution) -> bool:
    """Whether two solutions are one, as far as anybody can tell."""
    if "not_observable" in (before.status, after.status):
        return True
    std = np.sqrt(np.diag(after.inverse))
    return bool((np.abs(after.values - before.values) <= SETTLED * std).all())


def refine_start(window: Window, settings: FitSettings, longest_delay: float) -> Window:
    """The window with the strike's instant between two samples estimated: the best-fitting delay.

    The delay [s] lies between 0 and `longest_delay`. Its standard deviation is that of least squares, at most
    that of a uniform guess.
    """
    window = replace(window, longest_delay=longest_delay)
    problem = choose(window, settings).problem
    if "strike_time" in {*problem.names, *problem.known} or too_short(problem):
        return window
    joint = replace(problem, nonlinear=(*problem.nonlinear, "strike_time"))
    solution, _ = solve_with_noise(joint)
    if solution.status != "ok":
        return window
    uniform = longest_delay / math.sqrt(12.0)
    std = min(math.sqrt(float(solution.inverse[-1, -1])), uniform)
    return replace(window, delay=round(-float(solution.values[-1]), 9), delay_std=std)  # stamps: nanoseconds
