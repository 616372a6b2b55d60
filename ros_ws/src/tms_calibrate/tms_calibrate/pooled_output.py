"""Pooled fits as JSON and as tables for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from tms_fit.recording_fit import RecordingFit
from tms_model.bicycle import Array

from tms_calibrate.pooled_fit import PooledFit, Strike
from tms_calibrate.random_effects import RandomEffects

HETEROGENEITY_P = 0.01  # p of Cochran's Q below which the strikes differ


def together_json(fit: PooledFit, recordings: Sequence[RecordingFit]) -> dict[str, Any]:
    """Shared and own values with intervals, and the heterogeneity of each parameter, SI units."""
    problem = fit.solution.problem
    found = fit.solution.arrow is not None
    return {
        "bags": [str(one.recording.path) for one in recordings],
        "bicycles": list(dict.fromkeys(one.bicycle.name for one in recordings)),
        "status": fit.solution.status.value,
        "message": fit.solution.message,
        "shared": _intervals(problem.shared, fit.solution.shared, fit.shared_covariance, fit.quantile),
        "strikes": [_strike(fit, k) for k in range(len(fit.strikes))] if found else [],
        "left_out": [
            {"bag": one.recording, "strike": one.index, "message": one.alone.message} for one in fit.left_out
        ],
        "heterogeneity": {name: heterogeneity_json(one) for name, one in fit.between.items()},
        "priors": {name: [one.value, one.deviation] for name, one in problem.priors.items()},
        "noise": {"model": fit.noisy.model, **fit.noisy.parameters} if found else None,
        "least_squares": fit.noisy.least_squares if found else None,
        "residual_std": fit.residual_std if found else None,
        "degrees_of_freedom": problem.degrees_of_freedom,
        "sample_count": problem.count,
    }


def heterogeneity_json(one: RandomEffects) -> dict[str, Any]:
    """Random-effects mean with its intervals and heterogeneity."""
    return {**asdict(one), "ci95": list(one.ci95), "prediction95": list(one.prediction95)}


def _strike(fit: PooledFit, k: int) -> dict[str, Any]:
    one, run = fit.strikes[k], fit.solution.problem.runs[k]
    names = (*run.linear, *run.nonlinear)
    alone = one.alone
    return {
        "bag": one.recording,
        "strike": one.index,
        "seconds": one.seconds,
        "time_ns": one.start_ns,
        "parameters": _intervals(names, fit.solution.own[k], fit.own_covariance[k], fit.quantile),
        "alone": _intervals(alone.names, alone.values, alone.covariance, alone.quantile),
    }


def _intervals(names: Sequence[str], values: Array, covariance: Array, quantile: float) -> dict[str, Any]:
    std = np.sqrt(np.diag(covariance))
    return {
        name: {"value": float(v), "std": float(s), "ci95": [float(v - quantile * s), float(v + quantile * s)]}
        for name, v, s in zip(names, values, std, strict=False)
    }


def together_table(fit: PooledFit) -> str:
    """Table of shared values, own values of each strike, and heterogeneity of each parameter."""
    lines = [f"{len(fit.strikes)} strikes in one fit: {fit.solution.message or fit.solution.status.value}"]
    lines += [f"left out: strike {one.index} of {one.recording}: {one.alone.message}" for one in fit.left_out]
    if fit.solution.arrow is None:
        return "\n".join(lines)
    lines.append(f"noise: {_noise_in_words(fit)}")
    for name, one in _intervals(
        fit.solution.problem.shared, fit.solution.shared, fit.shared_covariance, fit.quantile
    ).items():
        low, high = one["ci95"]
        lines.append(f"shared  {name:24} {one['value']:+11.5f}  95 % [{low:+11.5f}, {high:+11.5f}]")
    lines.append(f"{'bag':24} {'start [s]':>10}  own unknowns, +/- a standard error")
    for k, strike in enumerate(fit.strikes):
        run = fit.solution.problem.runs[k]
        std = np.sqrt(np.diag(fit.own_covariance[k]))
        own = ", ".join(
            f"{name} {value:+.5f} +/- {error:.5f}"
            for name, value, error in zip(
                (*run.linear, *run.nonlinear), fit.solution.own[k], std, strict=True
            )
        )
        lines.append(f"{strike.recording:24} {strike.seconds:10.4f}  {own}")
    lines.append(between_table(fit.between))
    return "\n".join(lines)


def _noise_in_words(fit: PooledFit) -> str:
    """Noise model of all strikes in words, and the estimator of the values."""
    parameters = fit.noisy.parameters
    if fit.noisy.model == "white":
        return f"white, {parameters['noise_std']:.3g} rad/s"
    if fit.noisy.model == "oscillator":
        found = [f"{value:.1f} Hz" for name, value in parameters.items() if name.endswith("_frequency")]
        return (
            f"white with an oscillation of {' and '.join(found)}" if found else "white, no oscillation found"
        )
    values = "values of least squares" if fit.noisy.least_squares else "values that are best under it"
    return f"autoregressive: neighbouring residuals are alike; {values}, intervals with what it does to them"


def between_table(between: dict[str, RandomEffects]) -> str:
    """Table of random-effects means with Cochran's Q and I2, and whether the strikes agree."""
    lines = [
        f"{'each strike by itself':24} {'mean':>11} {'std error':>10} {'between':>10} {'Q':>9} {'p':>8}"
        f" {'I2':>6}"
    ]
    for name, one in between.items():
        if one.count < 2:
            continue
        word = "differ" if one.p < HETEROGENEITY_P else "agree"
        lines.append(
            f"{name:24} {one.mean:+11.5f} {one.std:10.5f} {one.between_std:10.5f} {one.q:9.2f} {one.p:8.2g}"
            f" {100.0 * one.i2:5.1f}%  {one.count} strikes {word}"
        )
    return "\n".join(lines)


def label(strike: Strike) -> str:
    """A strike in a few characters."""
    return f"{strike.recording} {strike.seconds:.1f} s"
