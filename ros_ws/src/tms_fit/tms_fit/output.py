"""Fits of a recording as a JSON document and as a table for the terminal."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

from tms_fit.diagnostics.output import diagnostics_json, diagnostics_lines, residual_tests_json
from tms_fit.diagnostics.stated_noise import StatedNoise, stated_noise
from tms_fit.estimate import Estimate, Status
from tms_fit.fit_warnings import fit_warnings
from tms_fit.least_squares.make_estimate import AUTOCORRELATION_WARNING
from tms_fit.parameters import DEFAULT_FREE
from tms_fit.recording_fit import RecordingFit, first_stamp
from tms_fit.settings import Settings
from tms_fit.speed_source import speed_json, speed_sentence
from tms_fit.strike_fit import StrikeFit
from tms_fit.strikes.strike import Strike
from tms_fit.strikes.thresholds import StrikeThresholds


def to_json(fit: RecordingFit, asked: Collection[str] = ()) -> dict[str, Any]:
    """Document of docs/conventions.md; SI units and radians, SAE signs.

    asked: further diagnostics of each strike: hypotheses, budget.
    """
    start_ns = first_stamp(fit.recording)
    stated = stated_noise(fit.recording, fit.settings)
    return {
        "bag": str(fit.recording.path),
        "bicycle": fit.bicycle.name,
        "start_ns": start_ns,
        "strikes": [_strike(one, fit.settings, asked, stated) for one in fit.strikes],
        "settings": fit.settings.as_json(),
        "rejected": [
            {"time_ns": one.time_ns, "lean_rate_change": one.change, "why": one.why} for one in fit.rejected
        ],
        "speed_source": speed_json(fit.recording, fit.settings),
        "recording": dict(fit.recording.custom_data),
        "warnings": fit_warnings(fit),
    }


def _strike(
    fit: StrikeFit, settings: Settings, asked: Collection[str], stated: StatedNoise | None
) -> dict[str, Any]:
    window = fit.window
    return {
        "time_ns": fit.start_ns,
        "window": [window.first_ns if window else fit.strike.time_ns, fit.end_ns],
        "ended_by": {"kind": fit.window_end.kind, "why": fit.window_end.why} if fit.window_end else None,
        "lean_rate_change": fit.strike.change,
        "detection": _detection(fit.strike),
        "start_std": window.delay_std if window else None,
        "speed": fit.speed if window else None,
        "speed_source": window.speed.source or None if window else None,
        "lean_rate_gain": window.lean_rate_gain if window else None,
        "estimates": [
            {**_estimate(one), "criticism": residual_tests_json(window, one, stated) if window else None}
            for one in fit.estimates
        ],
        **diagnostics_json(window, fit.estimates, fit.misspecification, settings, asked),
    }


def _detection(strike: Strike) -> dict[str, Any]:
    """Evidence of the detector for a strike, in words and numbers."""
    return {
        "kind": strike.kind,
        "why": strike.why,
        "onset_ns": strike.onset_ns,
        "end_ns": strike.end_ns,
        "end_std": strike.end_std,
        "rise": strike.rise,
        "needed": strike.needed,
        "noise": strike.noise,
        "sharp": strike.sharp,
    }


def _estimate(estimate: Estimate) -> dict[str, Any]:
    return {
        "estimator": estimate.estimator,
        "status": estimate.status.value,
        "message": estimate.message,
        "parameters": {
            name: {"value": one.value, "std": one.std, "ci95": [_end(one.ci95[0]), _end(one.ci95[1])]}
            for name, one in ((name, estimate[name]) for name in estimate)
        },
        "known": dict(estimate.known),
        "vaf": estimate.vaf,
        "sample_count": estimate.sample_count,
        "residual_std": estimate.residual_std,
        "log_likelihood": estimate.log_likelihood,
        "aic": estimate.aic,
        "bic": estimate.bic,
        "noise": {"model": estimate.noise_model, **estimate.noise},
        "loss": estimate.loss,
        "chosen": list(estimate.chosen),
        "correlation": estimate.correlation.tolist() if estimate.names else [],
        "residual_autocorrelation": estimate.residual_autocorrelation,
    }


def _end(value: float) -> float | None:
    """End of an interval; None where it is open."""
    return float(value) if math.isfinite(value) else None


def to_table(fit: RecordingFit, asked: Collection[str] = ()) -> str:
    """Table with one line per strike and estimator, reasons of detection, and signs of misspecification."""
    lines = [f"{fit.recording.path}: bicycle {fit.bicycle.name}, {len(fit.strikes)} strikes"]
    lines.append(speed_sentence(fit.recording, fit.settings))
    lines += [f"warning: {warning}" for warning in fit_warnings(fit)]
    if fit.strikes:
        lines.append(
            f"{'start [s]':>10} {'speed':>7}  {'estimator':14} {'initial lean rate [rad/s]':>38}"
            "   VAF lean, yaw"
        )
    for strike in fit.strikes:
        when = (strike.start_ns - first_stamp(fit.recording)) / 1e9
        for estimate in strike.estimates:
            known = strike.window.start_speed if strike.window else math.nan
            speed = f"{estimate.complete.get('speed', known):7.3f}".replace("nan", "  -")
            doubted = strike.misspecification is not None and estimate.names == strike.estimates[0].names
            mark = " *" if estimate.residual_autocorrelation > AUTOCORRELATION_WARNING else ""
            mark += " ?" if doubted else ""
            lines.append(f"{when:10.4f} {speed}  {estimate.estimator:14} {_in_words(estimate)}{mark}")
    lines.extend(_reasons(fit))
    lines.extend(
        f"{(one.start_ns - first_stamp(fit.recording)) / 1e9:10.4f} found: {_others(one.estimates[0])}"
        for one in fit.strikes
        if set(one.estimates[0].names) - set(DEFAULT_FREE)
    )
    stated = stated_noise(fit.recording, fit.settings)
    for one in fit.strikes:
        when = (one.start_ns - first_stamp(fit.recording)) / 1e9
        found = diagnostics_lines(
            one.window, one.estimates, one.misspecification, fit.settings, asked, stated
        )
        lines.extend(f"{when:10.4f} {line}" for line in found)
    if any(one.misspecification for one in fit.strikes):
        lines.append("? see the warning above: the model may be misspecified and the interval too narrow")
    if any(line.removesuffix(" ?").endswith(" *") for line in lines):
        lines.append("* the residuals are not white: the interval is too narrow (docs/conventions.md)")
    if not fit.strikes:
        least = StrikeThresholds().least_change
        lines.append(f"no strike: no sudden change of the lean rate of {least:g} rad/s or more within 0.3 s")
    return "\n".join(lines)


def _reasons(fit: RecordingFit) -> list[str]:
    """Reasons of each strike and its window end, and the number of rejected changes."""
    first = first_stamp(fit.recording)
    lines = [
        f"{(one.start_ns - first) / 1e9:10.4f} {one.strike.kind}: {one.strike.why}" for one in fit.strikes
    ]
    lines += [
        f"{(one.start_ns - first) / 1e9:10.4f} window {(one.end_ns - one.start_ns) / 1e9:.2f} s:"
        f" {one.window_end.why}"
        for one in fit.strikes
        if one.window_end
    ]
    if fit.rejected:
        lines.append(
            f"looked at and not taken: {len(fit.rejected)} changes (--json says why; --strike TIME overrides)"
        )
    return lines


def _others(estimate: Estimate) -> str:
    """Estimated parameters beside the initial lean rate, with standard errors."""
    found = {name: estimate[name] for name in estimate if name != "initial_lean_rate"}
    return ", ".join(f"{name} {one.value:.4g} +- {one.std:.2g}" for name, one in found.items())


def _in_words(estimate: Estimate) -> str:
    if estimate.status != Status.OK:
        return f"{estimate.status}: {estimate.message}"
    vaf = ", ".join(f"{value:.3f}" for value in estimate.vaf.values())
    if "initial_lean_rate" not in estimate:
        return f"{', '.join(f'{name} {value:.5f}' for name, value in estimate.parameters.items())}   {vaf}"
    found = estimate["initial_lean_rate"]
    low, high = found.ci95
    return f"{found.value:+9.5f}  95 % [{low:+9.5f}, {high:+9.5f}]   {vaf}"
