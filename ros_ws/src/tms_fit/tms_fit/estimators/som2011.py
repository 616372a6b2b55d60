"""The fit of the supplement, chapter 10: the initial lean rate from the lean rate alone, constant speed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tms_fit.estimate import Estimate
from tms_fit.estimators.least_squares import solve
from tms_fit.linear import answer
from tms_fit.window import Window

FREE = ("initial_lean_rate",)


def estimate(window: Window, free: tuple[str, ...], fixed: dict[str, float]) -> Estimate:
    """Initial lean rate from the lean rate; lean, steer, steer rate start at zero, whatever `free` says."""
    lean_only = replace(window, yaw_rate=np.full(len(window.time), np.nan))
    others = {name: value for name, value in fixed.items() if name not in FREE}
    return answer(
        "som2011", "least squares as in 2011", lean_only, FREE, others, lambda one: solve(one, FREE, others)
    )
