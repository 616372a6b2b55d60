"""Share of a lean-rate change that the bicycle's free response predicts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tms_fit.least_squares.problem import Problem, solve
from tms_fit.window import Window


def predicted_share(
    window: Window, before: NDArray[np.bool_], unknowns: tuple[str, ...], change: float
) -> float:
    """Predicted change of the lean rate from the last sample before to the last one, per observed change.

    before (n,): samples before the change; the bicycle's equations are fitted to these alone. unknowns:
    parameters of that fit. change [rad/s]: as observed. NaN where the samples don't determine the parameters.
    """
    earlier = replace(
        window,
        lean_rate=np.where(before, window.lean_rate, np.nan),
        yaw_rate=np.where(before, window.yaw_rate, np.nan),
    )
    problem = Problem(earlier, unknowns)
    good = np.isfinite(earlier.measured)
    solution = solve(problem, lambda values: values[good])
    if solution.status == "not_observable":
        return math.nan
    predicted = problem.predicted(solution.values)[:, 0]
    return float(predicted[-1] - predicted[np.flatnonzero(before)[-1]]) / change
