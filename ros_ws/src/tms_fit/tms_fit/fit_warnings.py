"""Warnings of a fitted recording."""

from __future__ import annotations

from tms_fit.diagnostics.remarks import estimate_remarks
from tms_fit.recording_fit import RecordingFit, first_stamp
from tms_fit.speed_profile import FIXED
from tms_fit.speed_source import recording_source
from tms_fit.strike_fit import StrikeFit


def fit_warnings(fit: RecordingFit) -> list[str]:
    """What is wrong with a recording, a speed of another name than usual, and the warnings of each strike."""
    found = list(fit.recording.warnings)
    remark = fit.recording.speed_topic.remark
    if remark and recording_source(fit.recording, fit.settings) != FIXED:
        found.append(remark)
    start_ns = first_stamp(fit.recording)
    for strike in fit.strikes:
        when = (strike.start_ns - start_ns) / 1e9
        found += [f"strike at {when:.4f} s: {text}" for text in strike_warnings(strike)]
    return found


def strike_warnings(strike: StrikeFit) -> list[str]:
    """What the first estimate of a strike assumes that was not measured or does not hold."""
    return estimate_remarks(strike.window, strike.estimates[0]) if strike.window else []
