"""Sensitivity of a calibration to the assumed initial state of each response.

A push of some tenths of a second leaves the bicycle leaning and steering when it ends. Where only the lean
rate is free there, all pushes are wrong in the same way: the numbers of the bicycle make up for it, and the
scatter from push to push, which makes the intervals, shows nothing of it. With the whole state free at each
start the numbers are less sure but don't depend on that (the comparison of J. A. Hausman, Econometrica 46
(1978), doi 10.2307/1913827).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from tms_fit.parameters import INITIAL
from tms_model.bicycle import Array

from tms_calibrate.calibration import Calibration, solve_balanced

MAX_SHIFT = 2.0  # stated standard errors; numbers that move by more depend on the start


@dataclass(frozen=True, eq=False)
class InitialStateSensitivity:
    """The numbers with lean, steer and both rates free at each start."""

    names: tuple[str, ...]
    values: Array  # (p,)
    std: Array  # (p,)
    moved: Array  # (p,) from the calibration, in its standard errors

    @property
    def matter(self) -> bool:
        """Whether some number depends on the start."""
        return bool((np.abs(self.moved) > MAX_SHIFT).any())

    @property
    def in_words(self) -> str:
        """One sentence."""
        told = ", ".join(
            f"{name} {self.values[k]:.4g} +/- {self.std[k]:.2g} ({self.moved[k]:+.1f} standard errors)"
            for k, name in enumerate(self.names)
            if not self.matter or abs(self.moved[k]) > MAX_SHIFT
        )
        if self.matter:
            return (
                "the intervals hold only if no push has leant or steered the bicycle by its end: with lean,"
                f" steer and steer rate of each start free, too: {told}; see --each"
            )
        return f"with lean, steer and steer rate of each start free, too: {told}"


def initial_state_sensitivity(calibration: Calibration) -> InitialStateSensitivity | None:
    """The calibration once more with the whole state free at each start; None where that can't be told."""
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
