"""The whole recording: lean rate, strikes, what the sensor could not show and what was lost on the way."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from tms_bag.samples import LeanYawSamples
from tms_model.bicycle import Array
from tms_model.frames import imu_to_rear_frame

from tms_fit.fit_warnings import fit_warnings
from tms_fit.gyroscopes import orientation_of
from tms_fit.recording_fit import RecordingFit, first_stamp
from tms_fit.report.chart import Columns
from tms_fit.report.charts.timeline import timeline_chart
from tms_fit.report.datasets import column
from tms_fit.report.element import Element, element, table
from tms_fit.report.rounding import fixed, typeset
from tms_fit.report.section import Section
from tms_fit.report.truth import true_events
from tms_fit.speed_source import speed_sentence

GAP = 1.5  # usual steps between samples; a longer one lacks some
REJECTED = "looked at, no strike"
BINS = 600  # of the envelope: more than a screen shows
SENSORS = {"accelerometer at its limit": 0b000111, "gyroscope at its limit": 0b111000}  # tms_msgs/LeanYaw


def timeline(fit: RecordingFit) -> Section:
    """The section about the recording as a whole."""
    time_ns, start = fit.recording.imu.time_ns, first_stamp(fit.recording)
    gaps, lost = gaps_of(time_ns)
    spans = [("strike", one.start_ns, one.end_ns) for one in fit.strikes]
    spans += [(REJECTED, one.time_ns, one.time_ns) for one in fit.rejected]
    spans += [("samples missing", first, last) for first, last in gaps]
    summary = fit.recording.lean_yaw
    if summary is not None:
        for name, flags in SENSORS.items():
            spans += [(name, first, last) for first, last in _saturated(summary, flags)]
    spans += [
        (f"truth: {one.kind}", one.time_ns, one.time_ns + round(1e9 * one.duration))
        for one in true_events(fit.recording)
        if one.kind != "phase"
    ]
    rates = imu_to_rear_frame(fit.recording.imu.angular_velocity, orientation_of(fit.recording.run_info))
    data = {"envelope": _envelope((time_ns - start) / 1e9, rates[:, 0]), "spans": _columns(spans, start)}
    kinds = tuple(dict.fromkeys(name for name, *_ in spans))
    return Section(
        "recording",
        "The recording",
        (
            _words(fit, gaps, lost),
            element("p", f"{speed_sentence(fit.recording, fit.settings).capitalize()}."),
            *(element("p", text, class_="caution") for text in fit_warnings(fit)),
        ),
        (timeline_chart(kinds, fit.recording.state is not None),),
        tables=_rejected(fit, start),
        data=data,
    )


def _rejected(fit: RecordingFit, start: int) -> tuple[Element, ...]:
    """Why sudden changes were not taken for strikes; nothing where there were none."""
    if not fit.rejected:
        return ()
    rows: list[list[Element | str]] = [
        [fixed((one.time_ns - start) / 1e9, 2), fixed(one.change, 2), typeset(one.why)]
        for one in fit.rejected
    ]
    head = ["at [s]", "change of the lean rate [rad/s]", "why it is no strike"]
    summary = element("summary", f"Changes that were looked at and not taken for strikes ({len(rows)})")
    return (element("details", summary, table(head, rows, class_="rejected")),)


def gaps_of(time_ns: NDArray[np.int64]) -> tuple[list[tuple[int, int]], int]:
    """Stretches [ns] without the samples that should be there, and how many those are."""
    steps = np.diff(time_ns)
    if not len(steps):
        return [], 0
    usual = float(np.median(steps))
    long = np.flatnonzero(steps > GAP * usual)
    missing = int(np.sum(np.round(steps[long] / usual) - 1))
    return [(int(time_ns[index]), int(time_ns[index + 1])) for index in long], missing


def _saturated(summary: LeanYawSamples, flags: int) -> list[tuple[int, int]]:
    """Runs of samples with one of these axes at its limit, as first and last stamp [ns]."""
    flagged = np.concatenate([[False], (summary.saturation & flags) > 0, [False]])
    edges = np.diff(flagged.astype(int))
    firsts, lasts = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return [
        (int(summary.time_ns[first]), int(summary.time_ns[last]))
        for first, last in zip(firsts, lasts, strict=True)
    ]


def _words(fit: RecordingFit, gaps: list[tuple[int, int]], lost: int) -> Element:
    time_ns, summary = fit.recording.imu.time_ns, fit.recording.lean_yaw
    span = (time_ns[-1] - time_ns[0]) / 1e9
    rate = f" at {1e9 / float(np.median(np.diff(time_ns))):.4g} Hz" if len(time_ns) > 1 else ""
    parts = [f"{len(time_ns)} inertial samples in {span:.1f} s{rate}."]
    parts.append(
        f"{lost} are missing, in {len(gaps)} gap{'s' if len(gaps) != 1 else ''}."
        if lost
        else "None is missing between the first and the last."
    )
    if fit.recording.duplicates:
        parts.append(f"{fit.recording.duplicates} repeated samples were left out.")
    if summary is None:
        parts.append("Whether the sensor was at its limits is not recorded.")
    else:
        limited = int(np.count_nonzero(summary.saturation))
        parts.append(
            f"{limited or 'No'} sample{'s are' if limited > 1 else ' is'} marked as at the sensor's limit."
        )
    return element("p", " ".join(parts))


def _envelope(time: Array, values: Array) -> Columns:
    """Least and greatest value in each of so many stretches of time, or the values where there are few."""
    count = min(BINS, len(time))
    edges = np.linspace(0, len(time), count + 1).astype(int)
    pieces = [values[first:last] for first, last in pairwise(edges)]
    return {
        "time": column(time[edges[:-1]]),
        "low": column(np.fmin.reduce(piece) for piece in pieces),
        "high": column(np.fmax.reduce(piece) for piece in pieces),
    }


def _columns(spans: list[tuple[str, int, int]], start: int) -> Columns:
    return {
        "kind": [kind for kind, *_ in spans],
        "first": column((first - start) / 1e9 for _, first, _ in spans),
        "last": column((last - start) / 1e9 for *_, last in spans),
    }
