"""Cross-validation of a calibration: each push left out in turn, and each recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from tms_fit.window import Window
from tms_model.bicycle import Array

from tms_calibrate.calibration import Calibration
from tms_calibrate.pooled_problem import PooledProblem, Run
from tms_calibrate.pooled_solver import solve_pooled

OWN_UNKNOWNS = ("initial_lean_rate",)  # all that a push that is judged may have of its own


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Calibration without some pushes, and its prediction of these."""

    values: Mapping[str, float]  # calibrated without them
    std: Mapping[str, float]
    vaf: Array  # (k,) of the lean rate of each push left out


def lean_rate_vaf(window: Window, numbers: Mapping[str, float], own: tuple[str, ...] = OWN_UNKNOWNS) -> float:
    """VAF of a window's lean rate by a bicycle with these numbers, unknowns `own` of the push solved for.

    NaN where there is no lean rate or where it doesn't tell them.
    """
    lean_only = replace(window, yaw_rate=np.full(len(window.time), np.nan))
    solution = solve_pooled(PooledProblem((Run(lean_only, own),), known=numbers))
    if solution.status != "ok":
        return float("nan")
    measured = lean_only.lean_rate[np.isfinite(lean_only.lean_rate)]
    return float(1.0 - np.var(solution.residuals[0]) / np.var(measured))


def leave_recordings_out(calibration: Calibration, labels: Sequence[str]) -> dict[str, LeftOut]:
    """For each recording, the calibration by the others; labels: of each run. Empty for one only.

    What a measurement counts against the priors stays as all recordings have it.
    """
    problem, answer = calibration.solution.problem, {}
    for label in dict.fromkeys(labels):
        kept = tuple(run for run, one in zip(problem.runs, labels, strict=True) if one != label)
        if len(kept) < 2:
            continue
        solution = solve_pooled(replace(problem, runs=kept), calibration.values)
        if solution.arrow is None:
            continue
        numbers = solution.shared_values
        std = dict(zip(numbers, np.sqrt(np.diag(solution.arrow.shared_inverse)).tolist(), strict=True))
        out = [run.window for run, one in zip(problem.runs, labels, strict=True) if one == label]
        answer[label] = LeftOut(numbers, std, np.array([lean_rate_vaf(window, numbers) for window in out]))
    return answer


def leave_runs_out(calibration: Calibration) -> tuple[Array, Array]:
    """Values (k, p) without each push in turn, to first order, and the VAF (k,) of its lean rate by them."""
    arrow, problem = calibration.solution.arrow, calibration.solution.problem
    assert arrow is not None
    residuals = [residual / problem.noise for residual in calibration.solution.residuals]
    precision = np.linalg.inv(calibration.covariance)
    values = []
    for projected, residual in zip(arrow.projected, residuals, strict=True):
        # At the optimum all gradients and the priors' pull add up to zero: without one, minus it is left.
        left = precision - projected.T @ projected
        values.append(calibration.values - np.linalg.solve(left, projected.T @ residual))
    vaf = [
        lean_rate_vaf(run.window, dict(zip(calibration.names, row.tolist(), strict=True)))
        for run, row in zip(problem.runs, values, strict=True)
    ]
    return np.array(values), np.array(vaf)


def jackknife_std(values: Array) -> Array:
    """Standard errors (p,) by the scatter of the values (k, p) without each push: of the data alone."""
    count = len(values)
    std: Array = np.sqrt((count - 1) / count * np.sum((values - values.mean(axis=0)) ** 2, axis=0))
    return std
