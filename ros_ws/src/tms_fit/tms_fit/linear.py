"""What the linear estimators share: from a way to solve for parameters to an estimate with uncertainty."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from tms_model.bicycle import Array

from tms_fit.estimate import Estimate
from tms_fit.prediction import predictor
from tms_fit.settings import CHANNELS
from tms_fit.window import Window, at_speed

LEAST_SAMPLES = 10  # scalar measurements beyond the number of unknowns
LEAST_SPAN = 0.25  # [s]
COLOURED = 0.3  # lag-one autocorrelation of the residuals above which they are called coloured
SPEED_STEP = 1e-4  # share of the speed, of the numerical derivatives with respect to it
DELAY_STEP = 1e-5  # [s], of the numerical derivatives with respect to the start


@dataclass(frozen=True, eq=False)
class Solution:
    """Result of one linear solve; empty arrays when the measurement does not tell the parameters apart."""

    values: Array  # (p,)
    inverse: Array  # (p, p), covariance per unit noise variance

    @property
    def observable(self) -> bool:
        """Whether there are values."""
        return len(self.values) > 0


Solver = Callable[[Window], Solution]


def answer(
    name: str, method: str, window: Window, free: tuple[str, ...], fixed: dict[str, float], solve: Solver
) -> Estimate:
    """The estimate of `free` by one way to solve for them; `method` says in words which.

    The noise variance is that of the residuals, equal for both channels. The covariance holds the uncertainty
    of the speed, and of the strike's instant between two samples, where the window states them.
    """
    reason = too_short(window, free)
    if reason:
        return Estimate(name, "too_short", reason)
    solution = solve(window)
    if not solution.observable:
        text = f"the measured channels do not tell {', '.join(free)} apart; free fewer of them"
        return Estimate(name, "not_observable", text)
    if not (np.isfinite(solution.values).all() and (np.diag(solution.inverse) > 0.0).all()):
        return Estimate(name, "not_converged", "the solution lost its precision; free fewer parameters")
    predicted = predictor(window).predict({**fixed, **dict(zip(free, solution.values, strict=True))})
    residual = window.measured - predicted
    count = int(np.isfinite(residual).sum())
    degrees = count - len(free) - (1 if window.delay_std else 0)
    variance = float(np.nansum(residual**2)) / degrees
    covariance = variance * solution.inverse
    if window.delay_std:
        shift = _shift(window, solve)
        covariance = covariance + np.outer(shift, shift) * window.delay_std**2
    if window.speed_std:
        shift = _shift_by_speed(window, solve)
        covariance = covariance + np.outer(shift, shift) * window.speed_std**2
    autocorrelation = lag_one_autocorrelation(residual)
    used = " and ".join(_measured_channels(window))
    return Estimate(
        estimator=name,
        status="ok",
        message=f"{method} on {used} over {window.time[-1]:.2f} s{_caution(autocorrelation)}",
        names=free,
        values=solution.values,
        covariance=covariance,
        degrees_of_freedom=degrees,
        residual_std=float(np.sqrt(variance)),
        vaf=variance_accounted_for(window, predicted),
        sample_count=count,
        residual_autocorrelation=autocorrelation,
    )


def variance_accounted_for(window: Window, predicted: Array) -> dict[str, float]:
    """VAF = 1 - var(measured - predicted) / var(measured) for each channel that was measured."""
    answer = {}
    for channel, measured, model in zip(CHANNELS, window.measured.T, predicted.T, strict=True):
        good = np.isfinite(measured)
        if good.sum() > 1 and np.var(measured[good]) > 0.0:
            answer[channel] = float(1.0 - np.var(measured[good] - model[good]) / np.var(measured[good]))
    return answer


def too_short(window: Window, free: tuple[str, ...]) -> str:
    """Why a window is too short to estimate `free`, or an empty text."""
    count = int(np.isfinite(window.measured).sum())
    span = float(window.time[-1]) if len(window.time) else 0.0
    if span < LEAST_SPAN or count < len(free) + LEAST_SAMPLES:
        return (
            f"expected at least {LEAST_SPAN} s and {len(free) + LEAST_SAMPLES} measurements after the strike"
            f" for {len(free)} unknowns, found {span:.3f} s and {count}"
        )
    return ""


def lag_one_autocorrelation(residual: Array) -> float:
    """Autocorrelation of neighbouring residuals (n, 2), of the channel where it is largest; white: near 0."""
    worst = float("nan")
    for channel in residual.T:
        good = channel[np.isfinite(channel)]
        if len(good) > 2 and np.ptp(good) > 0.0:
            centred = good - good.mean()
            worst = float(np.fmax(worst, centred[1:] @ centred[:-1] / (centred @ centred)))
    return worst


def _caution(autocorrelation: float) -> str:
    """What to add to the message when the residuals are not white."""
    if not autocorrelation > COLOURED:
        return ""
    return (
        f"; neighbouring residuals are alike (autocorrelation {autocorrelation:.2f}): the model misses"
        " something and the interval is too narrow"
    )


def _shift(window: Window, solve: Solver) -> Array:
    """Derivative (p,) of the solution with respect to the window's delay [1/s]."""
    low, high = max(window.delay - DELAY_STEP, 0.0), window.delay + DELAY_STEP
    ends = [solve(replace(window, delay=delay)).values for delay in (low, high)]
    return (ends[1] - ends[0]) / (high - low)


def _shift_by_speed(window: Window, solve: Solver) -> Array:
    """Derivative (p,) of the solution with respect to the speed [1/(m/s)]."""
    step = SPEED_STEP * window.system.speed
    ends = [solve(at_speed(window, window.system.speed + part)).values for part in (-step, step)]
    return (ends[1] - ends[0]) / (2.0 * step)


def _measured_channels(window: Window) -> list[str]:
    """Names, in words, of the channels that hold data."""
    return [
        channel.replace("_", " ")
        for channel, values in zip(CHANNELS, window.measured.T, strict=True)
        if np.isfinite(values).any()
    ]
