"""Noise that oscillates, as a shimmy of 20 Hz does: white noise and a stochastic damped oscillator.

Frequency, decay time and strength are what the residuals show (or what somebody states); as for
autoregressive noise the answer is an average over what they may be, on a grid around the likeliest: flat
priors in the frequency and in the logarithms of decay time and strength. A channel whose residuals show no
oscillation has white noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

import numpy as np
from tms_model.bicycle import Array

from tms_fit.least_squares.noise.coloured import Coloured, coloured
from tms_fit.least_squares.noise.oscillation import Oscillations

SLOWEST = 5.0  # [Hz]; what is slower may be the bicycle's own motion
DECAYS = np.geomspace(0.03, 10.0, 5)  # [s]
STRENGTHS = np.geomspace(0.1, 30.0, 6)  # of the oscillation per white noise
PLACES = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
ZOOMS = 3  # from one grid to the next
PEAKS = np.linspace(-0.6, 0.6, 3)  # frequencies around the periodogram's peak, per its resolution
UNKNOWNS = 3  # of an oscillator, that white noise doesn't have


def fit(time: Array, residual: Array, jacobian: Array, stated: Sequence[float] = ()) -> Coloured:
    """The noise that residuals (n, 2) show, whose fit had the derivatives (n, 2, p).

    stated: frequency [Hz], decay time [s] and deviation [rad/s] of the oscillator, as many as are known.
    """
    good = np.isfinite(residual)
    families = {
        c: _family(time[good[:, c]], residual[good[:, c], c], stated)
        for c in range(2)
        if good[:, c].sum() > 2
    }
    return coloured(families, good, residual, jacobian)


def _family(time: Array, residual: Array, stated: Sequence[float]) -> Oscillations:
    """What a channel's noise may be: one member, white, if that is likelier than the best oscillator."""
    white = Oscillations(time, np.array([SLOWEST]), np.ones(1), np.zeros(1))
    peak = _peak(time, residual)
    if not residual.any() or (peak is None and not stated):
        return white
    axes = _coarse(time, residual, peak or SLOWEST, stated)
    candidates = _grid(time, axes)
    least = _log_likelihoods(white, residual)[0] + 0.5 * UNKNOWNS * math.log(len(time))
    for _ in range(ZOOMS):
        likely = _log_likelihoods(candidates, residual)
        best = int(likely.argmax())
        centre = candidates.frequency[best], candidates.decay_time[best], candidates.ratio[best]
        wider, axes = (
            [_places(axis, one, k == 0, far) for k, (axis, one) in enumerate(zip(axes, centre, strict=True))]
            for far in (2.0, 1.0)
        )
        candidates = _grid(time, axes)
    return _grid(time, wider) if likely[best] > least else white


def _coarse(time: Array, residual: Array, peak: float, stated: Sequence[float]) -> list[Array]:
    """Values of frequency, decay time and strength to begin with; one of each that is stated."""
    resolution = 1.0 / float(time[-1] - time[0])
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


def _grid(time: Array, axes: Sequence[Array]) -> Oscillations:
    points = np.array(list(product(*axes)))
    return Oscillations(time, points[:, 0], points[:, 1], points[:, 2])


def _log_likelihoods(candidates: Oscillations, residual: Array) -> Array:
    """Of each candidate (g,), the variance at its best."""
    squares = candidates.products(residual[:, None])[:, 0, 0]
    found: Array = -0.5 * (len(residual) * np.log(squares) + candidates.log_determinants)
    return found


def _peak(time: Array, residual: Array) -> float | None:
    """Frequency [Hz] of the largest ordinate of the periodogram above SLOWEST; None if there is none."""
    if len(time) < 8:
        return None
    spacing = float(np.median(np.diff(time)))
    count = 4 * round(float(time[-1] - time[0]) / spacing + 1.0)  # finer than the resolution
    places = np.round((time - time[0]) / spacing).astype(int)
    even = np.zeros(count)
    even[places] = residual
    frequencies = np.fft.rfftfreq(count, spacing)
    power = np.where(frequencies >= SLOWEST, np.abs(np.fft.rfft(even)), 0.0)
    return float(frequencies[int(power.argmax())]) if power.any() else None
