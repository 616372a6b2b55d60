"""The numbers behind a strike's charts, by the names that the specifications use.

Columns of floats, NaN as None. Six significant digits are more than a screen or a page shows; the tables
carry the full ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from tms_bag.samples import StateSamples
from tms_model import Bicycle, Stability, follow_modes
from tms_model.bicycle import Array

from tms_fit.comparison import SHOWN_BEFORE_S, Comparison
from tms_fit.parameters import CHANNELS
from tms_fit.recording_fit import RecordingFit
from tms_fit.report.chart import Columns

SLIDING = 1e-6  # [m/s] lateral speed of a contact from which on it is said to slip
HIGHEST_SPEED = 10.0  # [m/s] of the eigenvalues' axis, or more when the run was faster
CURVES = 121  # speeds of the eigenvalues' curves
RUNAWAY = 3.0  # times the largest measured rate of a channel: predictions beyond it are not drawn
NORMAL = 61  # points of the normal curve


def column(values: Iterable[float]) -> list[float | None]:
    """Floats as JSON has them, to six significant digits."""
    return [float(f"{value:.6g}") if math.isfinite(value) else None for value in map(float, values)]


def series(both: Comparison) -> Columns:
    """Measured and predicted rates with the band; before the free response only what was measured."""
    time = np.concatenate([both.before_time, both.time])
    nothing = np.full((len(both.before_time), 2), np.nan)
    measured = np.concatenate([both.before, both.measured])
    predicted = np.concatenate([nothing, both.predicted])
    half = np.concatenate([nothing, both.half])
    # A prediction that runs away would make everything else a flat line.
    largest = np.fmax.reduce(np.abs(measured), axis=0)
    predicted[np.abs(predicted) > RUNAWAY * np.where(np.isfinite(largest), largest, np.inf)] = np.nan
    columns: Columns = {"time": column(time)}
    for channel, name in enumerate(CHANNELS):
        columns[name] = column(measured[:, channel])
        columns[f"{name}_predicted"] = column(predicted[:, channel])
        columns[f"{name}_low"] = column((predicted - half)[:, channel])
        columns[f"{name}_high"] = column((predicted + half)[:, channel])
    return columns


def window(both: Comparison) -> Columns:
    """The stretch used for the fit."""
    return {"start": [0.0], "end": column([both.end])}


def truth(state: StateSamples, start_ns: int, last: float) -> Columns:
    """True rates and speed of a simulated bicycle around a strike."""
    seconds = (state.time_ns - start_ns) / 1e9
    rows = np.flatnonzero((seconds >= -SHOWN_BEFORE_S) & (seconds <= last))
    return {
        "time": column(seconds[rows]),
        "lean_rate": column(state.state[rows, 2]),
        "yaw_rate": column(state.yaw_rate[rows]),
        "speed": column(state.speed[rows]),
    }


def slips(state: StateSamples, start_ns: int, last: float) -> Columns:
    """Stretches in which a contact of a simulated bicycle slips, around a strike."""
    seconds = (state.time_ns - start_ns) / 1e9
    slip = np.nan_to_num(np.abs(np.stack([state.rear_slip, state.front_slip]))).max(axis=0)
    sliding = np.concatenate(
        [[False], (slip > SLIDING) & (seconds >= -SHOWN_BEFORE_S) & (seconds <= last), [False]]
    )
    edges = np.diff(sliding.astype(int))
    firsts, lasts = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    step = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 0.0
    return {"start": column(seconds[firsts]), "end": column(seconds[lasts] + step)}


def speed_samples(fit: RecordingFit, start_ns: int, last: float) -> Columns | None:
    """Readings of the speed sensor around a strike."""
    if fit.recording.speed is None:
        return None
    seconds = (fit.recording.speed.time_ns - start_ns) / 1e9
    rows = np.flatnonzero((seconds >= -SHOWN_BEFORE_S) & (seconds <= last))
    return {"time": column(seconds[rows]), "speed": column(fit.recording.speed.speed[rows])}


def residuals(both: Comparison, residual: Array) -> Columns:
    """Residuals (n, 2) of the samples used."""
    time = both.used.time + both.used.delay
    return {
        "time": column(time),
        **{name: column(residual[:, channel]) for channel, name in enumerate(CHANNELS)},
    }


def histogram(residual: Array, std: float) -> tuple[Columns, Columns]:
    """Counts of the residuals (n,) of one channel, and the normal curve of that deviation and count."""
    good = residual[np.isfinite(residual)]
    counts, edges = np.histogram(good, bins=min(max(len(good) // 12, 5), 30))
    width = edges[1] - edges[0]
    reach = max(float(np.abs(edges).max()), 3.0 * std)
    at = np.linspace(-reach, reach, NORMAL)
    normal = len(good) * width * np.exp(-0.5 * (at / std) ** 2) / (std * math.sqrt(2.0 * math.pi))
    bars = {"low": column(edges[:-1]), "high": column(edges[1:]), "count": column(counts)}
    return bars, {"residual": column(at), "count": column(normal)}


def eigenvalues(bicycle: Bicycle, fastest: float) -> tuple[Columns, tuple[str, ...]]:
    """Eigenvalues by mode from standstill on, and the modes' names."""
    highest = max(HIGHEST_SPEED, 1.2 * fastest)
    # Closer at low speeds, where modes meet and curves are steep.
    course = follow_modes(bicycle, highest * np.linspace(0.0, 1.0, CURVES) ** 2)
    rows = [
        (curve, speed, name, value)
        for speed, values, names in zip(course.speeds, course.eigenvalues, course.names, strict=True)
        for curve, (value, name) in enumerate(zip(values, names, strict=True))
    ]
    columns: Columns = {
        "curve": [curve for curve, *_ in rows],
        "speed": column(speed for _, speed, *_ in rows),
        "mode": [name for _, _, name, _ in rows],
        "real": column(value.real for *_, value in rows),
        "imaginary": column(value.imag if value.imag > 1e-9 else math.nan for *_, value in rows),
    }
    return columns, tuple(dict.fromkeys(columns["mode"]))


def stable_ranges(answer: Stability, highest: float) -> Columns:
    """Speeds at which the bicycle is stable, cut at the end of the axis."""
    inside = [(low, min(high, highest)) for low, high in answer.stable_speed_ranges if low < highest]
    return {"low": column(low for low, _ in inside), "high": column(high for _, high in inside)}


def run_speeds(fit: RecordingFit, both: Comparison) -> Columns:
    """Lowest and highest measured speed during the free response, and the one used."""
    used = both.start_speed
    low = high = used
    if fit.recording.speed is not None:
        time_ns, speed = fit.recording.speed.time_ns, fit.recording.speed.speed
        inside = speed[(time_ns >= both.strike.start_ns) & (time_ns <= both.strike.end_ns)]
        inside = inside[np.isfinite(inside)]
        if len(inside):
            low, high = min(used, float(inside.min())), max(used, float(inside.max()))
    return {"low": column([low]), "high": column([high]), "used": column([used])}
