"""Classification of a change of the lean rate as impulse, push or neither, by the samples around it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array

from tms_fit.strikes.edge import Edge, fit_edge
from tms_fit.strikes.strike import NANOSECONDS, Rejected, Strike
from tms_fit.strikes.thresholds import StrikeThresholds

LEAST_SAMPLES = 10  # that determine the noise; with fewer no change is detected
MEAN_LENGTH_NS = 50_000_000  # [ns] of the running mean: one period of a 20 Hz shimmy
LONGEST_SUDDEN_RISE_S = 0.03  # a shorter rise is no part of a push
LARGEST_STEP_RATIO = 2.0  # largest step per change of the running mean; one sample among five has 5
LEAST_KINK_RATIO = 0.43  # kink per change; a push of 0.15 s has 0.4 at most, an impulse of 0.08 s 0.45 to 0.6
SWING_BACK = "the swing back from the last strike: soon after it, and not three times as large"
LEVEL_LENGTH_S = 0.025  # before the onset and after the end of a change, whose levels give its size


@dataclass(frozen=True, eq=False)
class DetectorHistory:
    """Samples, bins and means of the last two seconds."""

    time: NDArray[np.int64]  # (n,) [ns] of the samples
    rate: Array  # (n,) [rad/s]
    bin_time: NDArray[np.int64]  # (m,) [ns] of the bins, samples closer than 5 ms averaged
    bin_rate: Array  # (m,) [rad/s]
    bin_mean: Array  # (m,) [rad/s] running means
    kink: Array  # (m,) [rad/s]
    last: Strike | None


def classify_kink(
    history: DetectorHistory, trigger_ns: int, needed: float, settings: StrikeThresholds
) -> Strike | None:
    """A sudden change, by the fit of its edge; None where it is not sudden or not large enough."""
    time, rate = history.time, history.rate
    seconds = (time - trigger_ns) / NANOSECONDS
    edge = fit_edge(seconds, rate)
    if edge is None or not _is_sudden(edge, history, trigger_ns, settings):
        return None
    rise = _rise(edge, seconds, rate)
    if not _is_large(edge, rise, settings) or max(abs(edge.change), rise.size) < needed:
        return None
    end_ns = trigger_ns + round(edge.end * NANOSECONDS)
    if edge.sharp:
        before = int(np.argmin(np.abs(seconds - edge.step)))
        first, onset = before + 1, before
    else:
        first = int(np.searchsorted(time, end_ns))
        onset = max(0, int(np.searchsorted(time, end_ns - round(edge.rise * NANOSECONDS))) - 1)
    if not 0 < first < len(time) or _same_again(history.last, int(time[first]), settings):
        return None
    return Strike(
        time_ns=int(time[first]),
        before_ns=int(time[first - 1]),
        onset_ns=int(time[onset]),
        change=edge.change,
        noise=noise_of(rate[: onset + 1]),
        sharp=edge.sharp,
        end_ns=end_ns,
        end_std=edge.end_std,
        kind="strike",
        rise=edge.rise,
        needed=needed,
        why=_why(edge, rise, float(time[first] - time[first - 1]) / NANOSECONDS, needed),
    )


def classify_swing(
    history: DetectorHistory, trigger_ns: int, needed: float, settings: StrikeThresholds
) -> Strike | Rejected:
    """A push by hand, or the reason to reject it: too round, too small or too soon."""
    time, rate = history.bin_time, history.bin_rate
    trigger = int(np.searchsorted(time, trigger_ns))
    base = _base(history, trigger, settings)
    sign = math.copysign(1.0, rate[trigger] - rate[base])
    noise = noise_of(rate[: trigger + 1])
    smooth, spread = _running_mean(time, sign * rate)
    peak = trigger + int(np.argmax(smooth[trigger:]))
    step = base + int(np.argmax(np.diff(sign * rate[base : peak + 1])))
    jump, level = sign * (rate[step + 1] - rate[step]), smooth[peak] - sign * rate[base]
    if jump > LARGEST_STEP_RATIO * level:
        return Rejected(int(time[step + 1]), float(sign * level), "one sample alone stands out")
    sharp = bool(jump > 0.5 * level)
    start = step + 1 if sharp else _top(time, smooth, base, peak, noise * spread)
    change = float(rate[start] if sharp else sign * smooth[start]) - float(rate[base])
    refusal = _refusal(history, (base, start), change, noise, settings)
    if refusal:
        return Rejected(int(time[start]), change, refusal)
    quiet = np.flatnonzero(sign * (rate[base:start] - rate[base]) <= 3.0 * noise)
    begin = step if sharp else base + int(quiet[-1])
    rise = float(time[start] - time[begin]) / NANOSECONDS
    row = max(1, int(np.argmin(np.abs(history.time - time[start]))))
    onset = int(np.argmin(np.abs(history.time - time[begin])))
    return Strike(
        time_ns=int(history.time[row]),
        before_ns=int(history.time[row - 1]),
        onset_ns=int(history.time[onset]),
        change=change,
        noise=noise_of(history.rate[: onset + 1]),
        sharp=sharp and int(history.time[row]) == int(time[start]),  # a mean has no instant between samples
        end_ns=int(history.time[row]),
        end_std=0.0,
        kind="strike" if sharp else "push",
        rise=rise,
        needed=needed,
        why=f"the lean rate changes by {change:+.3f} rad/s within {rise:.2f} s, steeper than a swing;"
        f" {needed:.2f} rad/s or more was needed",
    )


def is_swing_back(last: Strike | None, strike: Strike, settings: StrikeThresholds) -> bool:
    """Whether a push may be the swing back from the last strike: soon after, and not three times as large."""
    if last is None or strike.time_ns - last.time_ns >= settings.refractory * NANOSECONDS:
        return False
    return abs(strike.change) < 3.0 * abs(last.change)


def noise_of(rates: Array) -> float:
    """Standard deviation of white noise, from the median absolute difference of neighbours (n,)."""
    if len(rates) < LEAST_SAMPLES:
        return 0.0
    return float(1.4826 * np.median(np.abs(np.diff(rates)))) / math.sqrt(2.0)


@dataclass(frozen=True)
class _Rise:
    """Change of the level from before a change to after it, in the direction of the fitted jump."""

    size: float  # [rad/s]; -inf: there are no samples on one side
    std: float  # [rad/s]


def _why(edge: Edge, rise: _Rise, spacing: float, needed: float) -> str:
    between = f"between two samples {1e3 * spacing:.1f} ms apart"
    how = between if edge.sharp else f"within {1e3 * edge.rise:.0f} ms"
    level = (
        f", its level by {math.copysign(rise.size, edge.change):+.3f}" if abs(edge.change) < needed else ""
    )
    shimmy = f"; a shimmy of {edge.shimmy:.1f} Hz is fitted along" if edge.shimmy else ""
    return (
        f"the lean rate jumps by {edge.change:+.3f} +- {edge.change_std:.3f} rad/s {how}{level};"
        f" {needed:.2f} rad/s or more was needed{shimmy}"
    )


def _is_sudden(edge: Edge, history: DetectorHistory, trigger_ns: int, settings: StrikeThresholds) -> bool:
    """Whether a short rise explains the change, not only one of the two bends of a push."""
    if edge.push_share >= 0.5:
        return False
    if edge.sharp or edge.rise < LONGEST_SUDDEN_RISE_S:
        return True
    rise = settings.rise * NANOSECONDS
    around = np.abs(history.bin_time - trigger_ns) <= rise
    near = around & (history.bin_time <= trigger_ns + 2 * MEAN_LENGTH_NS)
    return float(np.abs(history.kink[near]).max()) > LEAST_KINK_RATIO * float(
        np.ptp(history.bin_mean[around])
    )


def _is_large(edge: Edge, rise: _Rise, settings: StrikeThresholds) -> bool:
    """Whether the fitted jump, or else the rise from before to after it, is as large as a strike's.

    The bicycle's immediate response is part of the rise; a jump of 50 ms and a change of slope there differ
    in when they end, not in their sizes.
    """
    if abs(edge.change) - edge.change_std >= settings.least_change:
        return True
    return abs(edge.change) > edge.change_std and rise.size - rise.std >= settings.least_change


def _rise(edge: Edge, seconds: Array, rate: Array) -> _Rise:
    """The rise of the level over an edge; seconds, rate: (n,)."""
    onset = edge.end - edge.rise
    before = rate[(seconds >= onset - LEVEL_LENGTH_S) & (seconds < onset)]
    after = rate[(seconds >= edge.end) & (seconds <= edge.end + LEVEL_LENGTH_S)]
    if not len(before) or not len(after):
        return _Rise(-math.inf, 0.0)
    rise = float(np.median(after) - np.median(before))  # one outlier is no rise
    std = noise_of(rate[seconds < onset]) * math.sqrt(1.0 / len(before) + 1.0 / len(after))
    return _Rise(math.copysign(1.0, edge.change) * rise, std)


def _same_again(last: Strike | None, time_ns: int, settings: StrikeThresholds) -> bool:
    """Whether this is the other bend of the last strike."""
    return last is not None and time_ns - last.time_ns < 0.5 * settings.rise * NANOSECONDS


def _base(history: DetectorHistory, trigger: int, settings: StrikeThresholds) -> int:
    """The bin that a change is measured from: the farthest of those before it."""
    since = history.bin_time[trigger] - settings.rise * NANOSECONDS
    if history.last is not None:
        since = max(since, history.last.time_ns)
    first = min(int(np.searchsorted(history.bin_time, since)), trigger - 1)
    rate = history.bin_rate
    return first + int(np.argmax(np.abs(rate[trigger] - rate[first:trigger])))


def _refusal(
    history: DetectorHistory, rows: tuple[int, int], change: float, noise: float, settings: StrikeThresholds
) -> str:
    """The reason why a change between two rows of the bins is no push, or an empty text."""
    time, rate, (base, start) = history.bin_time, history.bin_rate, rows
    # The change is measured from the farthest of many samples: noise alone makes up two deviations.
    if abs(change) - 2.0 * noise < settings.least_change:
        return f"only {abs(change):.3f} rad/s, with noise of {noise:.3f} rad/s"
    around = (time >= time[base] - MEAN_LENGTH_NS) & (time <= time[start] + MEAN_LENGTH_NS)
    steepest = _steepest(time[around], rate[around], noise)
    if steepest * 0.2 < settings.steepness * abs(change):
        return f"too round: at most {steepest:.2f} rad/s^2 over 0.1 s, {abs(change):.3f} rad/s in all"
    return ""


def _top(time: NDArray[np.int64], smooth: Array, base: int, peak: int, noise: float) -> int:
    """Where the push ends: its extremum, or where its level was first reached to stay over 50 ms."""
    reached = base + int(np.argmax(smooth[base : peak + 1] >= smooth[peak] - 2.0 * noise))
    return reached if time[peak] - time[reached] > 0.05 * NANOSECONDS else peak


def _running_mean(time: NDArray[np.int64], values: Array) -> tuple[Array, float]:
    """Centred mean over 50 ms, shorter at the ends, (n,); and the share of white noise that is left."""
    low = np.searchsorted(time, time - MEAN_LENGTH_NS // 2)
    high = np.searchsorted(time, time + MEAN_LENGTH_NS // 2, side="right")
    sums = np.concatenate([[0.0], np.cumsum(values)])
    return (sums[high] - sums[low]) / (high - low), 1.0 / math.sqrt(float(np.median(high - low)))


def _steepest(time_ns: NDArray[np.int64], rate: Array, noise: float) -> float:
    """Largest least-squares slope [rad/s^2] over 0.1 s, less twice its standard deviation."""
    seconds = (time_ns - time_ns[0]) / NANOSECONDS
    slopes = [0.0]
    for first in range(len(seconds) - 2):
        last = int(np.searchsorted(seconds, seconds[first] + 0.1 + 1e-9))
        if last - first < 3 or (last == len(seconds) and first > 0 and seconds[-1] - seconds[first] < 0.08):
            break
        x = seconds[first:last] - seconds[first:last].mean()
        slopes.append(abs(float(x @ rate[first:last] / (x @ x))) - 2.0 * noise / math.sqrt(float(x @ x)))
    return max(slopes)
