"""Oscillator noise model, as for a shimmy of 20 Hz: white noise and a stochastic damped oscillator.

Frequency, decay time and strength are estimated from the residuals or stated. As for autoregressive noise,
parameters are averaged over candidates on a grid around the likeliest: flat
priors in the frequency and in the logarithms of decay time and strength. A channel whose residuals show no
oscillation has white noise.
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

SLOWEST = 5.0  # [Hz]; what is slower may be the bicycle's own motion
DECAYS = np.geomspace(0.03, 10.0, 5)  # [s]
STRENGTHS = np.geomspace(0.1, 30.0, 6)  # of the oscillation per white noise
PLACES = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
ZOOMS = 3  # from one grid to the next
PEAKS = np.linspace(-0.6, 0.6, 3)  # frequencies around the periodogram's peak, per its resolution
WHITE = np.array([[SLOWEST, 1.0, 0.0]])  # candidate without oscillation
UNKNOWNS = 3  # of an oscillator, that white noise doesn't have


def fit(time: Array, residual: Array, jacobian: Array, stated: Sequence[float] = ()) -> ColoredNoise:
    """The likeliest noise by residuals (n, 2) of a fit with derivatives (n, 2, p), and its candidates.

    stated: frequency [Hz], decay time [s] and deviation [rad/s] of the oscillator, as many as are known.
    """
    good = np.isfinite(residual)
    found = {
        c: candidates([time[good[:, c]]], [residual[good[:, c], c]], stated)
        for c in range(2)
        if good[:, c].sum() > 2
    }
    return colored_noise(families(time, good, found), residual, jacobian)


def candidates(times: Sequence[Array], residuals: Sequence[Array], stated: Sequence[float] = ()) -> Array:
    """Candidates for the noise of a channel by its residuals (n,) at times (n,) in each run.

    Rows (g, 3) of frequency [Hz], decay time [s] and strength per white noise; one with strength 0, white, if
    that is likelier than the best oscillator.
    """
    together = np.concatenate(residuals)
    peak = _peak(times, residuals)
    if not together.any() or (peak is None and not stated):
        return WHITE
    longest = max(float(time[-1] - time[0]) for time in times)
    axes = _coarse(longest, together, peak or SLOWEST, stated)
    grid = _grid(axes)
    least = _log_likelihoods(WHITE, times, residuals)[0] + 0.5 * UNKNOWNS * math.log(len(together))
    zooms = ZOOMS + round(0.5 * math.log2(len(times)))  # the more runs, the closer together
    for _ in range(zooms):
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
    """Those of some candidates (g, 3) whose log-likelihood is no more than `fall` below the likeliest's."""
    logs = _log_likelihoods(found, times, residuals)
    kept: Array = found[logs >= logs.max() - fall]
    return kept


def families(time: Array, good: NDArray[np.bool_], found: Mapping[int, Array]) -> dict[int, Oscillations]:
    """The candidates of each channel at the samples of a run: times (n,), measured (n, 2)."""
    return {c: _family(time[good[:, c]], one) for c, one in found.items() if good[:, c].sum() > 2}


def _family(time: Array, found: Array) -> Oscillations:
    return Oscillations(time, *found.T)


def _coarse(longest: float, residual: Array, peak: float, stated: Sequence[float]) -> list[Array]:
    """Values of frequency, decay time and strength to begin with; one of each that is stated."""
    resolution = 1.0 / longest
    axes = [peak + resolution * PEAKS, DECAYS, STRENGTHS]
    axes[: len(stated)] = [np.array([value]) for value in stated]
    if len(stated) > 2:  # per white noise, which has what the oscillator leaves of the residuals' variance
        left = max(float(np.mean(residual**2)) - stated[2] ** 2, 1e-4 * stated[2] ** 2)
        axes[2] = np.array([stated[2] / math.sqrt(left)])
    return axes


def _places(axis: Array, value: float, even: bool, far: float) -> Array:
    """Five places around a value, to `far` steps of an axis; by ratio where the axis isn't even."""
    if len(axis) < 2:
        return axis
    if even:
        return value + float(axis[1] - axis[0]) * far * PLACES
    places: Array = value * float(axis[1] / axis[0]) ** (far * PLACES)
    return places


def _grid(axes: Sequence[Array]) -> Array:
    frequencies, *others = axes
    if len(frequencies) > 1:  # not stated
        frequencies = np.unique(np.maximum(frequencies, SLOWEST))
    return np.array(list(product(frequencies, *others)))


def _log_likelihoods(grid: Array, times: Sequence[Array], residuals: Sequence[Array]) -> Array:
    """Of each candidate (g,), the variance at its best."""
    squares, determinants, count = np.zeros(len(grid)), np.zeros(len(grid)), 0
    for time, residual in zip(times, residuals, strict=True):
        one = _family(time, grid)
        squares += one.products(residual[:, None])[:, 0, 0]
        determinants += one.log_determinants
        count += len(residual)
    found: Array = -0.5 * (count * np.log(squares) + determinants)
    return found


def _peak(times: Sequence[Array], residuals: Sequence[Array]) -> float | None:
    """Frequency [Hz] above SLOWEST where the periodograms' sum is largest; None if there is none."""
    if max(len(time) for time in times) < 8:
        return None
    spacing = float(np.median(np.concatenate([np.diff(time) for time in times])))
    lengths = [round(float(time[-1] - time[0]) / spacing + 1.0) for time in times]
    count = 4 * max(lengths)  # finer than the resolution
    frequencies = np.fft.rfftfreq(count, spacing)
    power = np.zeros(len(frequencies))
    for time, residual in zip(times, residuals, strict=True):
        even = np.zeros(count)
        even[np.round((time - time[0]) / spacing).astype(int)] = residual
        power += np.abs(np.fft.rfft(even)) ** 2
    power[frequencies < SLOWEST] = 0.0
    return float(frequencies[int(power.argmax())]) if power.any() else None
