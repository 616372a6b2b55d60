"""End of an impulse from the lean rate around it, averaged over its possible rises.

Before the impulse the lean rate is a parabola over the short stretch looked at, after it another one; between
them it rises as under half a sine of force, (1 - cos(pi s / rise)) / 2. For every end and rise on a grid the
remaining unknowns are linear; the residual sums give each pair its weight, exp(-sum / (2 variance)), and the
answer is the weighted mean, which has the least mean square error (D. V. Lindley, Introduction to Probability
and Statistics from a Bayesian Viewpoint, 1965). A shimmy seen before the impulse is fitted
along with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tms_model.bicycle import Array

RISES = (0.0, 0.005, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1, 0.12, 0.15, 0.2, 0.3)  # [s]
RISE_SCALE_S = 0.005  # of the prior: beyond it a rise twice as long is half as likely
LONGEST_IMPULSE_S = 0.14  # a longer change is a push
HALF_LENGTH_S = 0.14  # fitted on either side, more where that is fewer than 7 samples
MIDDLE_SEARCH_S = 0.045  # on either side of the expected middle of the change
NOTICE_DELAY_S = 0.02  # from the expected middle of a change to its detection
GRID_STEP_S = 0.002  # of the grid of ends
LEAST_SPACING_S = 0.0025  # samples closer than this are averaged first
SHIMMY_BAND_HZ = (12.0, 30.0)
HIGHEST_FREQUENCY_RATIO = 0.46  # of a shimmy per sample rate
PEAK_POWER_RATIO = 15.0  # least power of a shimmy's peak per median power
ROUNDING = 1e-12  # remainder of the trend, per largest rate, up to which it is rounding
UNKNOWN_COUNT = 6  # the parabola before, the jump, slope and curvature added after it


@dataclass(frozen=True)
class Edge:
    """End, size and duration of a sudden change. Times in seconds, on the caller's axis."""

    end: float
    end_std: float
    rise: float  # how long the change took
    change: float  # [rad/s]
    change_std: float  # [rad/s]
    sharp: bool  # more likely than not no sample lies within the rise
    step: float  # the sample before a sharp change; else NaN
    push_share: float  # weight of the rises longer than LONGEST_IMPULSE_S
    shimmy: float  # [Hz], 0: none seen


def fit_edge(time: Array, rate: Array) -> Edge | None:
    """The edge just before time zero, where a change was detected; None where there are too few samples.

    time, rate: (n,) ascending [s], [rad/s].
    """
    time, rate = thinned(time, rate)
    spacing = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    near, half = -max(NOTICE_DELAY_S, spacing), max(HALF_LENGTH_S, 7.0 * spacing)
    reach = max(MIDDLE_SEARCH_S, 1.5 * spacing)
    used = (time >= near - half) & (time <= near + half)
    x, y = time[used], rate[used]
    quiet = time < near - reach
    frequency = shimmy_frequency(time[quiet], rate[quiet])
    unknowns = UNKNOWN_COUNT + (2 if frequency else 0)
    if len(x) < unknowns + 3 or (x < near).sum() < 3 or (x > near).sum() < 3:
        return None
    middles = near + np.arange(-reach, reach, max(GRID_STEP_S, spacing / 8.0))
    ends = np.array([middles + rise / 2.0 for rise in RISES])
    fits = [_residual_sums(_columns(x, e, r, half, frequency), y) for e, r in zip(ends, RISES, strict=True)]
    sums, jumps, jump_variances = (np.array([fit[k] for fit in fits]) for k in range(3))
    variance = max(float(sums.min()) / (len(x) - unknowns - 2), 1e-12 * float(np.var(y)) + 1e-300)
    weight = np.exp(-0.5 * (sums - sums.min()) / variance) / (1.0 + np.array(RISES)[:, None] / RISE_SCALE_S)
    weight /= weight.sum()
    end, change = float((weight * ends).sum()), float((weight * jumps).sum())
    share, step = between_samples(x, ends, np.array(RISES), weight)
    return Edge(
        end=end,
        end_std=float(np.sqrt((weight * (ends - end) ** 2).sum() + GRID_STEP_S**2 / 12.0)),
        rise=float(weight.sum(axis=1) @ np.array(RISES)),
        change=change,
        change_std=float(np.sqrt((weight * (variance * jump_variances + (jumps - change) ** 2)).sum())),
        sharp=share > 0.5 and spacing > LEAST_SPACING_S,
        step=step,
        push_share=float(weight[np.array(RISES) > LONGEST_IMPULSE_S].sum()),
        shimmy=frequency,
    )


def thinned(time: Array, rate: Array) -> tuple[Array, Array]:
    """Means of as many neighbours as fit into `LEAST_SPACING_S` seconds; time (n,), rate (n, ...)."""
    spacing = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    count = max(1, int(LEAST_SPACING_S / spacing + 1e-6))
    whole = len(time) // count * count
    rates = rate[:whole].reshape(-1, count, *rate.shape[1:])
    return time[:whole].reshape(-1, count).mean(axis=1), rates.mean(axis=1)


def between_samples(x: Array, ends: Array, rises: Array, weight: Array) -> tuple[float, float]:
    """Weight of the rises (r,) between two samples, and the sample before the likeliest place of those.

    x (n,) samples; ends, weight (r, m).
    """
    starts = ends - rises[:, None]
    before = np.searchsorted(x, starts + 1e-9, side="right") - 1  # last sample at or before the start
    unseen = np.searchsorted(x, ends - 1e-9) == before + 1
    places = np.bincount(np.clip(before[unseen], 0, len(x) - 1), weight[unseen], len(x))
    return float(places.sum()), float(x[int(np.argmax(places))])


def shimmy_frequency(time: Array, rate: Array) -> float:
    """Frequency [Hz] of an oscillation between 12 and 30 Hz that stands out of (n,) samples; 0: none."""
    recent = time > time[-1] - 1.0 if len(time) else np.zeros(0, bool)
    x, y = time[recent], rate[recent]
    if len(x) < 30:
        return 0.0
    highest = min(SHIMMY_BAND_HZ[1], HIGHEST_FREQUENCY_RATIO * (len(x) - 1) / float(x[-1] - x[0]))
    trend = np.polynomial.Polynomial.fit(x, y, 4)
    y = (y - trend(x)) * np.hanning(len(x))
    if np.abs(y).max() <= ROUNDING * np.abs(rate[recent]).max():  # a sensor without noise: no spectrum
        return 0.0
    tones = np.arange(SHIMMY_BAND_HZ[0], highest, 0.25)
    power = np.abs(np.exp(-2j * np.pi * np.outer(tones, x - x[0])) @ y) ** 2
    best = int(np.argmax(power))
    return float(tones[best]) if power[best] > PEAK_POWER_RATIO * np.median(power) else 0.0


def _columns(x: Array, ends: Array, rise: float, half: float, frequency: float) -> Array:
    """Columns of the linear model of the lean rate, for each end: (m, n, p)."""
    since = (x - ends[:, None]) / half
    after = np.maximum(since, 0.0)
    if rise > 0.0:
        share = np.clip((x - ends[:, None]) / rise + 1.0, 0.0, 1.0)
        jump = 0.5 * (1.0 - np.cos(np.pi * share))
    else:
        jump = (since >= 0.0).astype(float)
    columns = [np.ones_like(since), since, since**2, jump, after, after**2]
    if frequency:
        phase = np.broadcast_to(2.0 * np.pi * frequency * x, since.shape)
        columns += [np.sin(phase), np.cos(phase)]
    return np.stack(columns, axis=2)


def _residual_sums(columns: Array, y: Array) -> tuple[Array, Array, Array]:
    """Residual sums, jumps and their variances for unit noise, each (m,), with columns (m, n, p)."""
    turned = columns.transpose(0, 2, 1)
    normal = turned @ columns
    normal = normal + 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(normal.shape[1])
    inverse = np.linalg.inv(normal)
    values = inverse @ (turned @ y)[:, :, None]
    residual = y - (columns @ values)[:, :, 0]
    return np.einsum("mn,mn->m", residual, residual), values[:, 3, 0], inverse[:, 3, 3]
