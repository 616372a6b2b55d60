"""Cross-validation of a calibration by leaving out each push or each recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from tms_fit.window import Window
from tms_model.bicycle import Array

from tms_calibrate.calibration import Calibration
from tms_calibrate.pooled_problem import PooledProblem, Run
from tms_calibrate.pooled_solver import solve_pooled

OWN_UNKNOWNS = ("initial_lean_rate",)  # fitted to each push of the validation


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Calibration without some pushes, and its prediction of those pushes."""

    values: Mapping[str, float]  # calibrated without them
    std: Mapping[str, float]
    vaf: Array  # (k,) of the lean rate of each push left out


def lean_rate_vaf(window: Window, numbers: Mapping[str, float], own: tuple[str, ...] = OWN_UNKNOWNS) -> float:
    """VAF of a window's lean rate for parameters `numbers`, with the unknowns `own` fitted to the window.

    NaN without lean rate, or where the lean rate does not determine the unknowns.
    """
    lean_only = replace(window, yaw_rate=np.full(len(window.time), np.nan))
    solution = solve_pooled(PooledProblem((Run(lean_only, own),), known=numbers))
    if solution.status != "ok":
        return float("nan")
    measured = lean_only.lean_rate[np.isfinite(lean_only.lean_rate)]
    return float(1.0 - np.var(solution.residuals[0]) / np.var(measured))


def leave_recordings_out(calibration: Calibration, labels: Sequence[str]) -> dict[str, LeftOut]:
    """Calibration by all other recordings, for each recording; empty for a single recording.

    labels: recording of each run. The noise, which weighs data against priors, stays that of all recordings.
    """
    problem, left_out = calibration.solution.problem, {}
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
        left_out[label] = LeftOut(numbers, std, np.array([lean_rate_vaf(window, numbers) for window in out]))
    return left_out


def leave_runs_out(calibration: Calibration) -> tuple[Array, Array]:
    """Values (k, p) without each push in turn, to first order, and the VAF (k,) of its lean rate by them."""
    arrow, problem = calibration.solution.arrow, calibration.solution.problem
    assert arrow is not None
    residuals = [residual / problem.noise for residual in calibration.solution.residuals]
    precision = np.linalg.inv(calibration.covariance)
    values = []
    for projected, residual in zip(arrow.projected, residuals, strict=True):
        # At the optimum the gradients of runs and priors sum to zero: leaving out one leaves its negative.
        left = precision - projected.T @ projected
        values.append(calibration.values - np.linalg.solve(left, projected.T @ residual))
    vaf = [
        lean_rate_vaf(run.window, dict(zip(calibration.names, row.tolist(), strict=True)))
        for run, row in zip(problem.runs, values, strict=True)
    ]
    return np.array(values), np.array(vaf)


def jackknife_std(values: Array) -> Array:
    """Jackknife standard errors (p,) from leave-one-out values (k, p)."""
    count = len(values)
    std: Array = np.sqrt((count - 1) / count * np.sum((values - values.mean(axis=0)) ** 2, axis=0))
    return std
