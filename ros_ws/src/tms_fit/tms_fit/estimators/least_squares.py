"""Linear least squares: the free response of Eq. (3.1) is linear in the initial states and biases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from tms_fit.estimate import Estimate
from tms_fit.linear import Solution, answer, too_short
from tms_fit.prediction import predictor
from tms_fit.window import Window


def estimate(window: Window, free: tuple[str, ...], fixed: dict[str, float]) -> Estimate:
    """Best-fitting `free` parameters, from all measured channels."""
    return answer(
        "least_squares", "linear least squares", window, free, fixed, lambda one: solve(one, free, fixed)
    )


def solve(window: Window, free: tuple[str, ...], fixed: dict[str, float]) -> Solution:
    """Ordinary least squares over all measured samples of both channels."""
    model = predictor(window)
    good = np.isfinite(window.measured)
    matrix = model.select(free)[good]
    target = (window.measured - model.predict(fixed))[good]
    scale = np.linalg.norm(matrix, axis=0)
    if not scale.all():
        return Solution(np.empty(0), np.empty((0, 0)))
    values, _, rank, _ = np.linalg.lstsq(matrix / scale, target, rcond=1e-9)
    if rank < len(free):
        return Solution(np.empty(0), np.empty((0, 0)))
    inverse = np.linalg.inv((matrix / scale).T @ (matrix / scale)) / np.outer(scale, scale)
    return Solution(values / scale, inverse)


def refine_start(
    window: Window, free: tuple[str, ...], fixed: dict[str, float], longest_delay: float
) -> Window:
    """The window with the strike's instant between two samples estimated: the best-fitting delay.

    The delay [s] lies between 0 and `longest_delay`. Its standard deviation comes from the curvature of the
    residual sum, at most that of a uniform guess.
    """
    if too_short(window, free) or not solve(window, free, fixed).observable:
        return window

    def residual_sum(delay: float) -> float:
        moved = replace(window, delay=float(delay))
        values = dict(zip(free, solve(moved, free, fixed).values, strict=True))
        return float(np.nansum((window.measured - predictor(moved).predict({**fixed, **values})) ** 2))

    best = minimize_scalar(
        residual_sum, bounds=(0.0, longest_delay), method="bounded", options={"xatol": 1e-6}
    )
    step = longest_delay / 10.0
    centre = min(max(float(best.x), step), longest_delay - step)
    around = [residual_sum(centre + offset) for offset in (-step, 0.0, step)]
    curvature = (around[0] - 2.0 * around[1] + around[2]) / step**2
    uniform = longest_delay / np.sqrt(12.0)
    degrees = int(np.isfinite(window.measured).sum()) - len(free) - 1
    std = min(float(np.sqrt(2.0 * best.fun / degrees / curvature)), uniform) if curvature > 0.0 else uniform
    return replace(window, delay=round(float(best.x), 9), delay_std=float(std))  # stamps know nanoseconds
