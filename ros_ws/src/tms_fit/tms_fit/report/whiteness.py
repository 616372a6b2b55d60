"""Residuals against their own past and over frequency: what a right model leaves is white.

Samples may be missing or unevenly spaced: the spectrum is Lomb and Scargle's periodogram (SciPy), on even
samples the ordinary one.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import lombscargle
from tms_model.bicycle import Array

from tms_fit.parameters import CHANNELS
from tms_fit.report.chart import Columns
from tms_fit.report.datasets import column

LONGEST_LAG = 0.5  # [s]
LEAST = 20  # residuals of a channel that make a spectrum


def autocorrelation(time: Array, residual: Array) -> Columns:
    """Autocorrelation of the residuals (n, 2) by lag, and the band (95 %) that white ones would keep to."""
    step = float(np.median(np.diff(time)))
    columns: Columns = {"lag": [], "channel": [], "value": [], "limit": []}
    for name, values in zip(CHANNELS, residual.T, strict=True):
        good = np.isfinite(values)
        if good.sum() < LEAST:
            continue
        centred = np.where(good, values - values[good].mean(), 0.0)  # a missing sample adds nothing
        power = centred @ centred
        lags = np.arange(1, min(round(LONGEST_LAG / step), len(values) // 2) + 1)
        columns["lag"] += column(lags * step)
        columns["channel"] += [name] * len(lags)
        columns["value"] += column(centred[lag:] @ centred[:-lag] / power for lag in lags.tolist())
        columns["limit"] += column([1.96 / math.sqrt(good.sum())] * len(lags))
    return columns


def spectrum(time: Array, residual: Array) -> Columns:
    """One-sided power density [(rad/s)^2/Hz] of the residuals (n, 2) up to half the sample rate."""
    step = float(np.median(np.diff(time)))
    columns: Columns = {"frequency": [], "channel": [], "density": [], "level": []}
    for name, values in zip(CHANNELS, residual.T, strict=True):
        good = np.isfinite(values)
        if good.sum() < LEAST:
            continue
        frequency, density = power_density(time[good], values[good], step)
        columns["frequency"] += column(frequency)
        columns["channel"] += [name] * len(frequency)
        columns["density"] += column(density)
        columns["level"] += column([2.0 * step * float(np.var(values[good]))] * len(frequency))
    return columns


def power_density(time: Array, values: Array, step: float) -> tuple[Array, Array]:
    """Frequencies [Hz] and one-sided density of values (n,) at times (n,) [s], usually `step` apart."""
    count = round(float(time[-1] - time[0]) / step) + 1
    frequency = np.arange(1, (count - 1) // 2 + 1) / (count * step)
    power = lombscargle(time, values - values.mean(), 2.0 * np.pi * frequency)
    density: Array = 2.0 * step * power
    return frequency, density
