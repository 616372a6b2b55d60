"""The fit of the supplement, chapter 10: the initial lean rate from the lean rate alone."""

from __future__ import annotations

from tms_fit.estimate import Estimate
from tms_fit.estimators import least_squares
from tms_fit.window import Window


def estimate(window: Window, free: tuple[str, ...], fixed: dict[str, float]) -> Estimate:
    """Initial lean rate from the lean rate; lean, steer, steer rate start at zero, whatever `free` says."""
    others = {name: value for name, value in fixed.items() if name != "initial_lean_rate"}
    return least_squares.estimate(window, ("initial_lean_rate",), others, ("lean_rate",), "som2011")
