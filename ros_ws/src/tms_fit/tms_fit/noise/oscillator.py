"""Oscillator noise model: white noise and a stochastic damped oscillator, such as a shimmy of 20 Hz.

Frequency, decay time and strength are estimated from the residuals or stated. As for autoregressive noise,
parameters are averaged over candidates on a grid around the likeliest, with flat priors in the frequency and
in the logarithms of decay time and strength. A channel without significant oscillation has white noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array

from tms_fit.noise.colored import ColoredNoise, colored_noise
from tms_fit.noise.oscillator_filter import Oscillations

MIN_FREQUENCY_HZ = 5.0  # above the bicycle's own motion
DECAY_TIMES_S = np.geomspace(0.03, 10.0, 5)
STRENGTHS = np.geomspace(0.1, 30.0, 6)  # standard deviation relative to the white noise
REFINED_STEPS = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])  # of a refined grid, in steps of the coarser one
REFINEMENTS = 3  # of the grid, for one run
FREQUENCY_STEPS = np.linspace(-0.6, 0.6, 3)  # around the periodogram's peak, in units of its resolution
WHITE = np.array([[MIN_FREQUENCY_HZ, 1.0, 0.0]])  # candidate without oscillation
PARAMETER_COUNT = 3  # of an oscillator, beside the variance of the white noise


def fit(time: Array, residual: Array, jacobian: Array, stated: Sequence[float] = ()) -> ColoredNoise:
    """Likeliest noise with its candidates, from residuals (n, 2) of a fit with derivatives (n, 2, p).

    stated: known parameters of the oscillator: frequency [Hz], decay time [s], standard deviation [rad/s].
    """
    good = np.isfinite(residual)
    found = {
        c: candidates([time[good[:, c]]], [residual[good[:, c], c]], stated)
        for c in range(2)
        if good[:, c].sum() > 2
    }
    return colored_noise(families(time, good, found), residual, jacobian)


def candidates(times: Sequence[Array], residuals: Sequence[Array], stated: Sequence[float] = ()) -> Array:
    """Candidate oscillators (g, 3) of a channel from its residuals (n,) at times (n,) in each run.

    Columns: frequency [Hz], decay time [s], strength relative to the white noise. A single candidate of
    strength 0 (white noise) if the best oscillator does not decrease BIC.
    """
    together = np.concatenate(residuals)
    peak = _peak(times, residuals)
    if not together.any() or (peak is None and not stated):
        return WHITE
    longest = max(float(time[-1] - time[0]) for time in times)
    axes = _coarse(longest, together, peak or MIN_FREQUENCY_HZ, stated)
    grid = _grid(axes)
    least = _log_likelihoods(WHITE, times, residuals)[0] + 0.5 * PARAMETER_COUNT * math.log(len(together))
    refinements = REFINEMENTS + round(0.5 * math.log2(len(times)))  # finer for more runs
    for _ in range(refinements):
        likely = _log_likelihoods(grid, times, residuals)
        best = int(likely.argmax())
        wider, axes = (
            [
                _places(axis, one, k == 0, far)
                for k, (axis, one) in enumerate(zip(axes, grid[best].tolist(), strict=True))
            ]
            for far in (2.0, 1.0)
        )
        grid = _grid(axes)
    return _grid(wider) if likely[best] > least else WHITE


def with_weight(found: Array, times: Sequence[Array], residuals: Sequence[Array], fall: float) -> Array:
    """Candidates (g, 3) with a log-likelihood at most `fall` below the maximum."""
    logs = _log_likelihoods(found, times, residuals)
    kept: Array = found[logs >= logs.max() - fall]
    return kept


def families(time: Array, good: NDArray[np.bool_], found: Mapping[int, Array]) -> dict[int, Oscillations]:
    """Candidate oscillators by channel at the samples of a run: times (n,) [s], measured (n, 2)."""
    return {c: _family(time[good[:, c]], one) for c, one in found.items() if good[:, c].sum() > 2}


def _family(time: Array, found: Array) -> Oscillations:
    return Oscillations(time, *found.T)


def _coarse(longest: float, residual: Array, peak: float, stated: Sequence[float]) -> list[Array]:
    """Coarse grid of frequency, decay time and strength; a single value of each that is stated."""
    resolution = 1.0 / longest
    axes = [peak + resolution * FREQUENCY_STEPS, DECAY_TIMES_S, STRENGTHS]
    axes[: len(stated)] = [np.array([value]) for value in stated]
    if len(stated) > 2:  # relative to the white noise, the rest of the residual variance
        left = max(float(np.mean(residual**2)) - stated[2] ** 2, 1e-4 * stated[2] ** 2)
        axes[2] = np.array([stated[2] / math.sqrt(left)])
    return axes


def _places(axis: Array, value: float, even: bool, far: float) -> Array:
    """Refined axis of five points around a value, up to `far` steps away; by ratio unless even."""
    if len(axis) < 2:
        return axis
    if even:
        return value + float(axis[1] - axis[0]) * far * REFINED_STEPS
    places: Array = value * float(axis[1] / axis[0]) ** (far * REFINED_STEPS)
    return places


def _grid(axes: Sequence[Array]) -> Array:
    frequencies, *others = axes
    if len(frequencies) > 1:  # not stated
        frequencies = np.unique(np.maximum(frequencies, MIN_FREQUENCY_HZ))
    return np.array(list(product(frequencies, *others)))


def _log_likelihoods(grid: Array, times: Sequence[Array], residuals: Sequence[Array]) -> Array:
    """Log-likelihood of each candidate (g,), maximised over the variance."""
    squares, determinants, count = np.zeros(len(grid)), np.zeros(len(grid)), 0
    for time, residual in zip(times, residuals, strict=True):
        one = _family(time, grid)
        squares += one.products(residual[:, None])[:, 0, 0]
        determinants += one.log_determinants
        count += len(residual)
    found: Array = -0.5 * (count * np.log(squares) + determinants)
    return found


def _peak(times: Sequence[Array], residuals: Sequence[Array]) -> float | None:
    """Peak frequency [Hz] of the summed periodograms above MIN_FREQUENCY_HZ; None without one."""
    if max(len(time) for time in times) < 8:
        return None
    spacing = float(np.median(np.concatenate([np.diff(time) for time in times])))
    lengths = [round(float(time[-1] - time[0]) / spacing + 1.0) for time in times]
    count = 4 * max(lengths)  # zero padding: finer than the resolution
    frequencies = np.fft.rfftfreq(count, spacing)
    power = np.zeros(len(frequencies))
    for time, residual in zip(times, residuals, strict=True):
        even = np.zeros(count)
        even[np.round((time - time[0]) / spacing).astype(int)] = residual
        power += np.abs(np.fft.rfft(even)) ** 2
    power[frequencies < MIN_FREQUENCY_HZ] = 0.0
    return float(frequencies[int(power.argmax())]) if power.any() else None
