"""Calibrations as JSON and as tables: values, identifiability and cross-validation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from tms_fit.speed_profile import constant_speed
from tms_model.bicycle import Array
from tms_model.changes import MATRIX_ENTRIES, numbers_of
from tms_model.parameters import MAY_BE_UNKNOWN, PARAMETER_NAMES

from tms_calibrate.calibration import DEFAULT_PRIOR_RELATIVE_STD, Calibration
from tms_calibrate.cross_validation import (
    LeftOut,
    jackknife_std,
    lean_rate_vaf,
    leave_recordings_out,
    leave_runs_out,
)
from tms_calibrate.identifiability import Identifiability, identify
from tms_calibrate.initial_state_sensitivity import InitialStateSensitivity, initial_state_sensitivity
from tms_calibrate.pooled_fit import Strike
from tms_calibrate.pooled_output import heterogeneity_json
from tms_calibrate.pooled_problem import Run

DATA_CONTRACTION, PRIOR_CONTRACTION = 0.75, 0.25  # limits of the words data and prior


@dataclass(frozen=True, eq=False)
class CrossValidationRow:
    """Cross-validation push by push, one initial lean rate fitted to each, and identifiability."""

    before: Array  # (k,) VAF of the lean rate by the parent bicycle
    after: Array  # (k,) by the calibrated one
    with_offset: Array  # (k,) the same with a constant offset per push beside the initial lean rate
    without_it: Array  # (k,) by the calibration of all other pushes
    jackknife: Array  # (p,) standard errors by leaving pushes out, data alone
    recordings: dict[str, LeftOut]  # by the calibration of the other recordings
    free: Identifiability  # of the calibrated parameters
    parameters: Identifiability | None  # of all parameters, with DEFAULT_PRIOR_RELATIVE_STD
    entries: Identifiability  # of the entries of the matrices, likewise
    starts: InitialStateSensitivity | None  # None: whole initial state free already, or not observable


def cross_validate(calibration: Calibration, strikes: Sequence[Strike]) -> CrossValidationRow:
    """Cross-validation of a calibration by its own strikes, in the same order."""
    found = calibration.solution.shared_values
    windows = [run.window for run in calibration.solution.problem.runs]
    left_out, vaf = leave_runs_out(calibration)
    priors = {name: prior.deviation for name, prior in calibration.priors.items()}
    return CrossValidationRow(
        before=np.array([lean_rate_vaf(window, {}) for window in windows]),
        after=np.array([lean_rate_vaf(window, found) for window in windows]),
        with_offset=np.array(
            [lean_rate_vaf(window, found, ("initial_lean_rate", "lean_rate_bias")) for window in windows]
        ),
        without_it=vaf,
        jackknife=jackknife_std(left_out),
        recordings=leave_recordings_out(calibration, [one.recording for one in strikes]),
        free=identify(calibration.solution.problem, found, priors),
        parameters=_all(calibration, PARAMETER_NAMES) if calibration.bicycle.parameters else None,
        entries=_all(calibration, MATRIX_ENTRIES),
        starts=initial_state_sensitivity(calibration),
    )


def _all(calibration: Calibration, names: tuple[str, ...]) -> Identifiability:
    """Identifiability of parameters of the parent bicycle under DEFAULT_PRIOR_RELATIVE_STD."""
    numbers = numbers_of(calibration.bicycle)
    scales = {
        name: DEFAULT_PRIOR_RELATIVE_STD * abs(numbers[name])
        for name in names
        if name not in MAY_BE_UNKNOWN and numbers.get(name, 0.0) != 0.0
    }
    problem = calibration.solution.problem
    if names == MATRIX_ENTRIES:  # which hold at one speed only
        problem = replace(problem, runs=tuple(_at_constant_speed(run) for run in problem.runs))
    return identify(problem, {name: numbers[name] for name in scales}, scales)


def _at_constant_speed(run: Run) -> Run:
    return replace(run, window=replace(run.window, speed=constant_speed(run.window.start_speed)))


def in_word(contraction: float) -> str:
    """Source of a value: data, prior, or both."""
    if contraction >= DATA_CONTRACTION:
        return "data"
    return "data and prior" if contraction > PRIOR_CONTRACTION else "prior"


def calibration_json(
    calibration: Calibration, strikes: Sequence[Strike], validation: CrossValidationRow
) -> dict[str, Any]:
    """Calibration, identifiability and cross-validation, SI units."""
    repeated = calibration.repeated
    return {
        "bicycle": calibration.bicycle.name,
        "status": calibration.solution.status.value,
        "message": calibration.solution.message,
        "parameters": {
            name: {
                "value": float(calibration.values[k]),
                "std": float(calibration.std[k]),
                "ci95": calibration.ci95[k].tolist(),
                "prior": calibration.priors[name].value,
                "prior_std": calibration.priors[name].deviation,
                "prior_source": calibration.prior_sources[name],
                "contraction": float(calibration.contraction[k]),
                "told_by": in_word(float(calibration.contraction[k])),
                "jackknife_std": float(validation.jackknife[k]),
                "each_push": heterogeneity_json(repeated[name]),
            }
            for k, name in enumerate(calibration.names)
        },
        "covariance": calibration.covariance.tolist(),
        "noise": calibration.solution.problem.noise,
        "design_effect": calibration.design_effect,
        "degrees_of_freedom": calibration.degrees_of_freedom,
        "free_starts": None if validation.starts is None else _starts_json(validation.starts),
        "identifiability": {
            "free": _identifiability_json(validation.free),
            "parameters": _identifiability_json(validation.parameters) if validation.parameters else None,
            "matrix_entries": _identifiability_json(validation.entries),
        },
        "strikes": [
            {
                "bag": one.recording,
                "strike": one.index,
                "seconds": one.seconds,
                "vaf_before": float(validation.before[k]),
                "vaf": float(validation.after[k]),
                "vaf_with_offset": float(validation.with_offset[k]),
                "vaf_left_out": float(validation.without_it[k]),
            }
            for k, one in enumerate(strikes)
        ],
        "recordings": {name: _medians(strikes, validation, name) for name in _recordings(strikes)},
    }


def _starts_json(starts: InitialStateSensitivity) -> dict[str, Any]:
    return {
        "matter": starts.matter,
        "parameters": {
            name: {"value": float(value), "std": float(std), "moved": float(moved)}
            for name, value, std, moved in zip(
                starts.names, starts.values, starts.std, starts.moved, strict=True
            )
        },
    }


def _identifiability_json(one: Identifiability) -> dict[str, Any]:
    return {
        "names": list(one.names),
        "scales": one.scales.tolist(),
        "singular_values": one.singular.tolist(),
        "combinations": [one.in_words(k) for k in range(len(one.singular))],
        "known": one.known,
        "std_alone": one.alone.tolist(),
        "std_together": one.together.tolist(),
    }


def _recordings(strikes: Sequence[Strike]) -> list[str]:
    return list(dict.fromkeys(one.recording for one in strikes))


def _medians(strikes: Sequence[Strike], validation: CrossValidationRow, name: str) -> dict[str, Any]:
    here = np.array([one.recording == name for one in strikes])
    medians: dict[str, Any] = {
        "strikes": int(here.sum()),
        "median_vaf_before": float(np.median(validation.before[here])),
        "median_vaf": float(np.median(validation.after[here])),
        "median_vaf_with_offset": float(np.median(validation.with_offset[here])),
        "median_vaf_left_out": float(np.median(validation.without_it[here])),
    }
    if name in validation.recordings:
        other = validation.recordings[name]
        medians["by_the_other_recordings"] = {
            "median_vaf": float(np.median(other.vaf)),
            "values": dict(other.values),
            "std": dict(other.std),
        }
    return medians


def calibration_table(
    calibration: Calibration, strikes: Sequence[Strike], validation: CrossValidationRow
) -> str:
    """Table of values and their sources, identifiable combinations, and medians of the VAF."""
    lines = [
        f"{calibration.bicycle.name}: {len(strikes)} strikes;"
        f" {calibration.design_effect:.1f} measurements tell as much as one independent one; 95 % intervals"
        f" by Student's t with {calibration.degrees_of_freedom:.0f} degrees of freedom"
    ]
    lines.append(
        f"{'number':26} {'prior':>19}  {'found':>19}  {'jackknife':>9}  {'told by':14}  each push by itself"
    )
    repeated = calibration.repeated
    for k, name in enumerate(calibration.names):
        prior, each = calibration.priors[name], repeated[name]
        lines.append(
            f"{name:26} {prior.value:9.4g} +/- {prior.deviation:5.2g}  {calibration.values[k]:9.4g} +/-"
            f" {calibration.std[k]:5.2g}  {validation.jackknife[k]:9.2g}"
            f"  {in_word(float(calibration.contraction[k])):14}"
            f"  Q {each.q:5.1f} of {each.count - 1}, p {each.p:.2g} ({calibration.prior_sources[name]} prior)"
        )
    if validation.starts is not None:
        lines.append(validation.starts.in_words)
    lines += _combinations(validation.free, "of these")
    within = f"each known within {100 * DEFAULT_PRIOR_RELATIVE_STD:.0f} %"
    if validation.parameters:
        lines += _combinations(validation.parameters, f"parameters, {within}")
    lines += _combinations(validation.entries, f"matrix entries, {within}")
    lines.append("median VAF of the lean rate, one initial lean rate per push and nothing else of that push:")
    lines.append(
        f"{'bag':24} {'pushes':>6} {'before':>8} {'found':>8} {'push left out':>14} {'bag left out':>13}"
    )
    for name in _recordings(strikes):
        one = _medians(strikes, validation, name)
        other = one.get("by_the_other_recordings", {}).get("median_vaf")
        lines.append(
            f"{name:24} {one['strikes']:6} {one['median_vaf_before']:8.3f} {one['median_vaf']:8.3f}"
            f" {one['median_vaf_left_out']:14.3f} {'-' if other is None else f'{other:.3f}':>13}"
        )
    return "\n".join(lines)


def _combinations(one: Identifiability, what: str) -> list[str]:
    """Lines of the combinations that the data determine better than the priors, best first."""
    lines = [f"the data know {one.known} of {len(one.names)} combinations {what} better than the priors:"]
    for k in range(one.known):
        lines.append(f"  {one.singular[k]:8.3g} times better: {one.in_words(k)}")
    return lines
