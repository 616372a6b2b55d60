"""Sensitivity of a calibration to the assumed initial state of each response.

At the end of a push of some tenths of a second the bicycle leans and steers already. Where only the initial
lean rate is free, this error is common to all pushes: it biases the parameters of the bicycle, and the
scatter between pushes, hence the intervals, do not include it. With the whole initial state free the
parameters are less precise but free of this bias (specification test of J. A. Hausman, Econometrica 46
(1978), doi 10.2307/1913827).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from tms_fit.parameters import INITIAL
from tms_model.bicycle import Array

from tms_calibrate.calibration import Calibration, solve_balanced

MAX_SHIFT = 2.0  # standard errors, above which a parameter depends on the assumed initial state


@dataclass(frozen=True, eq=False)
class InitialStateSensitivity:
    """Parameters calibrated with lean, steer and both rates free at each start."""

    names: tuple[str, ...]
    values: Array  # (p,)
    std: Array  # (p,)
    moved: Array  # (p,) change from the calibration, in its standard errors

    @property
    def matter(self) -> bool:
        """Whether some parameter depends on the assumed initial state."""
        return bool((np.abs(self.moved) > MAX_SHIFT).any())

    @property
    def in_words(self) -> str:
        """Result in one sentence."""
        values = ", ".join(
            f"{name} {self.values[k]:.4g} +/- {self.std[k]:.2g} ({self.moved[k]:+.1f} standard errors)"
            for k, name in enumerate(self.names)
            if not self.matter or abs(self.moved[k]) > MAX_SHIFT
        )
        if self.matter:
            return (
                "the intervals hold only if no push has leant or steered the bicycle by its end: with lean,"
                f" steer and steer rate of each start free, too: {values}; see --each"
            )
        return f"with lean, steer and steer rate of each start free, too: {values}"


def initial_state_sensitivity(calibration: Calibration) -> InitialStateSensitivity | None:
    """Calibration with the whole initial state free; None where it is free already or not observable."""
    problem = calibration.solution.problem
    if all(set(INITIAL) <= set(run.names) for run in problem.runs):
        return None
    runs = tuple(
        replace(run, linear=(*run.linear, *(name for name in INITIAL if name not in run.names)))
        for run in problem.runs
    )
    solution = solve_balanced(replace(problem, runs=runs))
    if solution.status != "ok" or solution.arrow is None:
        return None
    std = np.sqrt(np.diag(solution.arrow.shared_inverse))
    moved = (solution.shared - calibration.values) / calibration.std
    return InitialStateSensitivity(calibration.names, solution.shared, std, moved)
