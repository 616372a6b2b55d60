"""Linear least squares: the free response of Eq. (3.1) is linear in the initial states and biases."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar
from tms_model.bicycle import Array

from tms_fit.estimate import Estimate, caution, lag_one_autocorrelation, too_short, variance_accounted_for
from tms_fit.prediction import predictor
from tms_fit.settings import CHANNELS
from tms_fit.window import Window

DELAY_STEP = 1e-5  # [s], of the numerical derivatives with respect to the start


@dataclass(frozen=True, eq=False)
class Solution:
    """Result of one linear solve; values is empty when the columns are not independent."""

    values: Array  # (p,)
    inverse: Array  # (p, p), inverse of the normal matrix: the covariance per unit noise variance
    residual_sum: float  # [rad^2/s^2]
    count: int


def estimate(
    window: Window,
    free: tuple[str, ...],
    fixed: dict[str, float],
    channels: tuple[str, ...] = CHANNELS,
    name: str = "least_squares",
) -> Estimate:
    """Best-fitting `free` parameters; noise variance from the residuals, equal for both channels.

    The covariance holds the uncertainty of the strike's instant between two samples, where the window states
    one.
    """
    window = _only(window, channels)
    reason = too_short(window, free)
    if reason:
        return Estimate(name, "too_short", reason)
    solution = solve(window, free, fixed)
    if not len(solution.values):
        return Estimate(
            name,
            "not_observable",
            f"the measured channels do not tell {', '.join(free)} apart; free fewer of them",
        )
    degrees = solution.count - len(free) - (1 if window.delay_std else 0)
    variance = solution.residual_sum / degrees
    covariance = variance * solution.inverse
    if window.delay_std:
        shift = sensitivity(window, lambda moved: solve(moved, free, fixed).values)
        covariance = covariance + np.outer(shift, shift) * window.delay_std**2
    predicted = predictor(window).predict({**fixed, **dict(zip(free, solution.values, strict=True))})
    autocorrelation = lag_one_autocorrelation(window, predicted)
    used = " and ".join(measured_channels(window))
    return Estimate(
        estimator=name,
        status="ok",
        message=f"linear least squares on {used} over {window.time[-1]:.2f} s{caution(autocorrelation)}",
        names=free,
        values=solution.values,
        covariance=covariance,
        degrees_of_freedom=degrees,
        residual_std=float(np.sqrt(variance)),
        vaf=variance_accounted_for(window, predicted),
        sample_count=solution.count,
        residual_autocorrelation=autocorrelation,
    )


def solve(window: Window, free: tuple[str, ...], fixed: dict[str, float]) -> Solution:
    """Ordinary least squares over all measured samples of both channels."""
    model = predictor(window)
    good = np.isfinite(window.measured)
    matrix = model.select(free)[good]
    target = (window.measured - model.predict(fixed))[good]
    scale = np.linalg.norm(matrix, axis=0)
    if not scale.all():
        return Solution(np.empty(0), np.empty((0, 0)), float("nan"), len(target))
    values, _, rank, _ = np.linalg.lstsq(matrix / scale, target, rcond=1e-9)
    if rank < len(free):
        return Solution(np.empty(0), np.empty((0, 0)), float("nan"), len(target))
    residual = target - matrix @ (values / scale)
    inverse = np.linalg.inv((matrix / scale).T @ (matrix / scale)) / np.outer(scale, scale)
    return Solution(values / scale, inverse, float(residual @ residual), len(target))


def refine_start(
    window: Window, free: tuple[str, ...], fixed: dict[str, float], longest_delay: float
) -> Window:
    """The window with the strike's instant between two samples estimated: the best-fitting delay.

    The delay [s] lies between 0 and `longest_delay`. Its standard deviation comes from the curvature of the
    residual sum, at most that of a uniform guess.
    """
    if too_short(window, free) or not len(solve(window, free, fixed).values):
        return window

    def residual_sum(delay: float) -> float:
        return solve(replace(window, delay=float(delay)), free, fixed).residual_sum

    best = minimize_scalar(
        residual_sum, bounds=(0.0, longest_delay), method="bounded", options={"xatol": 1e-6}
    )
    step = longest_delay / 10.0
    centre = min(max(float(best.x), step), longest_delay - step)
    around = [residual_sum(centre + offset) for offset in (-step, 0.0, step)]
    curvature = (around[0] - 2.0 * around[1] + around[2]) / step**2
    uniform = longest_delay / np.sqrt(12.0)
    degrees = int(np.isfinite(window.measured).sum()) - len(free) - 1
    std = min(float(np.sqrt(2.0 * around[1] / degrees / curvature)), uniform) if curvature > 0.0 else uniform
    return replace(window, delay=float(best.x), delay_std=float(std))


def sensitivity(window: Window, values: Callable[[Window], Array]) -> Array:
    """Derivative (p,) of `values(window)` with respect to the window's delay [1/s]."""
    low, high = max(window.delay - DELAY_STEP, 0.0), window.delay + DELAY_STEP
    return (values(replace(window, delay=high)) - values(replace(window, delay=low))) / (high - low)


def measured_channels(window: Window) -> list[str]:
    """Names, in words, of the channels that hold data."""
    return [
        channel.replace("_", " ")
        for channel, values in zip(CHANNELS, window.measured.T, strict=True)
        if np.isfinite(values).any()
    ]


def _only(window: Window, channels: tuple[str, ...]) -> Window:
    if channels == CHANNELS:
        return window
    absent = np.full(len(window.time), np.nan)
    return replace(
        window,
        lean_rate=window.lean_rate if "lean_rate" in channels else absent,
        yaw_rate=window.yaw_rate if "yaw_rate" in channels else absent,
    )
