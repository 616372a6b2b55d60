"""Strikes found from the lean rate alone, sample by sample: a live run and a recorded one find the same.

A strike (an impulse, or a push by hand of up to 0.3 s) changes the lean rate faster than the bicycle itself
does. A change counts as a strike when, within `rise` seconds,

1. it is larger than `least_change`, six times the noise, and the fading memory of the swings just before (a
   bicycle that rings down swings less each time);
2. it is steep: its steepest 0.1 s (less what noise feigns), kept up for 0.2 s, would make up the change; a
   weave oscillation is rounder;
3. the last strike is at least `refractory` seconds ago, or was less than a third of it.

The free response starts where the push ends: at the extremum of the smoothed lean rate, or where its level is
first reached when it then stays. When one sample step holds more than half of the change, the strike fell
between those two samples (`sharp`).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array

NANOSECONDS = 1_000_000_000
LONGEST_GAP = 0.15  # [s] without samples; across a longer one no change is known to be sudden
LEAST_SAMPLES = 10  # that show the noise; before them no change can be told from it


@dataclass(frozen=True)
class StrikeSettings:
    """When a change of the lean rate is a strike."""

    least_change: float = 0.15  # [rad/s]
    rise: float = 0.3  # [s], longest push
    refractory: float = 1.0  # [s], between the starts of two free responses
    memory: float = 0.6  # [s], time constant with which earlier swings are forgotten
    steepness: float = 0.8  # steepest slope over 0.1 s times 0.2 s, per change


@dataclass(frozen=True)
class Strike:
    """One strike. Times are integer nanoseconds."""

    time_ns: int  # first sample of the free response
    before_ns: int  # last sample before it
    onset_ns: int  # last sample before the lean rate began to change
    change: float  # [rad/s], of the lean rate, by the strike
    noise: float  # [rad/s], standard deviation of the lean rate's noise as seen just before
    sharp: bool  # the strike fell between before_ns and time_ns


class StrikeDetector:
    """Finds strikes in a stream of lean rates. Same samples, same strikes, whoever feeds them."""

    def __init__(self, settings: StrikeSettings | None = None) -> None:
        self._settings = settings or StrikeSettings()
        self._time: deque[int] = deque()  # [ns]
        self._rate: deque[float] = deque()  # [rad/s]
        self._memory: deque[float] = deque()  # fading memory of swings, after each sample
        self._trigger_ns: int | None = None
        self._last: deque[Strike] = deque(maxlen=2)

    @property
    def latency(self) -> float:
        """Seconds after the start of a free response until it is reported, at most."""
        return 2.0 * self._settings.rise

    def push(self, time_ns: int, lean_rate: float) -> Strike | None:
        """Take one sample (ascending times, [rad/s]); return the strike that it completes, if any."""
        if not math.isfinite(lean_rate):
            return None
        strike = None
        if self._time and time_ns - self._time[-1] > LONGEST_GAP * NANOSECONDS:
            strike = self._judge()  # on what there is; across the gap no change is known to be sudden
            self._forget()
        swing = self._swing(time_ns, lean_rate)
        earlier = self._earlier_memory(time_ns)
        self._append(time_ns, lean_rate, swing)
        if self._trigger_ns is None:
            large = swing > max(self._settings.least_change, earlier)
            # The noise, a median, is asked for last: on a quiet ride that is hardly ever.
            if large and len(self._time) > LEAST_SAMPLES and swing > 6.0 * self._noise():
                self._trigger_ns = time_ns
        elif time_ns - self._trigger_ns >= self._settings.rise * NANOSECONDS:
            strike = self._judge()
        return strike

    def withdraw(self) -> None:
        """Take back the last strike: who knows the bicycle found it to be its free response."""
        self._last.pop()

    def _forget(self) -> None:
        self._time.clear()
        self._rate.clear()
        self._memory.clear()
        self._trigger_ns = None

    def _swing(self, time_ns: int, lean_rate: float) -> float:
        """Largest change from any sample of the last `rise` seconds to this one."""
        since = time_ns - self._settings.rise * NANOSECONDS
        latest_first = zip(reversed(self._time), reversed(self._rate), strict=True)
        recent = takewhile(lambda sample: sample[0] >= since, latest_first)
        return max((abs(lean_rate - rate) for _, rate in recent), default=0.0)

    def _earlier_memory(self, time_ns: int) -> float:
        """Memory of the swings as it stood before the present change can have begun, faded until now."""
        since = time_ns - self._settings.rise * NANOSECONDS
        for when, memory in zip(reversed(self._time), reversed(self._memory), strict=True):
            if when < since:
                return memory * math.exp(-(time_ns - when) / NANOSECONDS / self._settings.memory)
        return 0.0

    def _append(self, time_ns: int, lean_rate: float, swing: float) -> None:
        if self._time:
            fade = math.exp(-(time_ns - self._time[-1]) / NANOSECONDS / self._settings.memory)
            swing = max(swing, self._memory[-1] * fade)
        self._time.append(time_ns)
        self._rate.append(lean_rate)
        self._memory.append(swing)
        while self._time[-1] - self._time[0] > 2 * NANOSECONDS:
            self._time.popleft()
            self._rate.popleft()
            self._memory.popleft()

    def _noise(self, until: int | None = None) -> float:
        """Standard deviation of white noise, from the median absolute difference of neighbours."""
        rates = np.array(self._rate)[:until]
        if len(rates) < LEAST_SAMPLES:
            return 0.0
        return float(1.4826 * np.median(np.abs(np.diff(rates)))) / math.sqrt(2.0)

    def _judge(self) -> Strike | None:
        """The strike around the trigger, if there is one; None when the change was too round or too soon."""
        if self._trigger_ns is None:
            return None
        trigger_ns, self._trigger_ns = self._trigger_ns, None
        time, rate = np.array(self._time), np.array(self._rate)
        trigger = int(np.searchsorted(time, trigger_ns))
        first = int(np.searchsorted(time, trigger_ns - self._settings.rise * NANOSECONDS))
        base = first + int(
            np.argmax(np.abs(rate[trigger] - rate[first:trigger]))
        )  # where the change is measured from
        sign = math.copysign(1.0, rate[trigger] - rate[base])
        noise = self._noise(trigger)
        smooth = _moving_average(sign * rate, 5)
        peak = trigger + int(np.argmax(smooth[trigger:]))
        step = base + int(
            np.argmax(np.diff(sign * rate[base : peak + 1]))
        )  # largest between neighbours: step, step + 1
        sharp = sign * (rate[step + 1] - rate[step]) > 0.5 * (smooth[peak] - sign * rate[base])
        start = step + 1 if sharp else self._top(time, smooth, base, peak, noise)
        change = float(rate[start] - rate[base])
        # The change is measured from the farthest of many samples: noise alone makes up two deviations.
        if abs(change) - 2.0 * noise < self._settings.least_change or self._too_soon(
            int(time[start]), change
        ):
            return None
        around = slice(max(0, base - 5), start + 6)
        if _steepest(time[around], rate[around], noise) * 0.2 < self._settings.steepness * abs(change):
            return None
        quiet = np.flatnonzero(sign * (rate[base:start] - rate[base]) <= 3.0 * noise)
        onset = step if sharp else base + int(quiet[-1])
        first_ns, before_ns, onset_ns = (int(time[index]) for index in (start, start - 1, onset))
        self._last.append(Strike(first_ns, before_ns, onset_ns, change, noise, bool(sharp)))
        return self._last[-1]

    def _too_soon(self, time_ns: int, change: float) -> bool:
        """Whether this is the swing back from the last strike: at most twice as large, and soon after."""
        if not self._last or time_ns - self._last[-1].time_ns >= self._settings.refractory * NANOSECONDS:
            return False
        return abs(change) < 3.0 * abs(self._last[-1].change)

    @staticmethod
    def _top(time: NDArray[np.int64], smooth: Array, base: int, peak: int, noise: float) -> int:
        """Where the push ends: its extremum, or where its level was first reached to stay over 50 ms."""
        reached = base + int(
            np.argmax(smooth[base : peak + 1] >= smooth[peak] - 2.0 * noise / math.sqrt(5.0))
        )
        return reached if time[peak] - time[reached] > 0.05 * NANOSECONDS else peak


def _moving_average(values: Array, width: int) -> Array:
    """Centred moving average, shorter at the ends; same length as values (n,)."""
    kernel = np.ones(width)
    return np.convolve(values, kernel, "same") / np.convolve(np.ones_like(values), kernel, "same")


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
