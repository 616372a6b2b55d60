"""Sequential strike detector on the lean rate alone.

A strike (an impulse, or a push by hand of up to 0.3 s) changes the lean rate faster than the bicycle does by
itself. All lengths are in seconds, for any sample rate from 25 Hz to 4 kHz; samples closer than 5 ms are
averaged for the search, and a running mean over 50 ms, one period of a 20 Hz shimmy, suppresses that and most
of the noise. Two features make a change a candidate:

- a swing: the mean has changed within `rise` by more than `least_change`, six times its noise, and the
  exponentially decaying maximum of earlier swings (a bicycle that rings down swings less each time);
- a kink: three successive means of 50 ms depart from a line by more than `least_change` and six times their
  usual departure.

`rise` seconds later the change is classified (`tms_fit.strikes.classification`). After a kink,
`tms_fit.strikes.edge` fits it: if it most likely took less than 0.14 s it is a strike, and the free response
starts where the fitted impulse ends (if no sample lies within it, the strike is `sharp`: its time is
estimated with the bicycle's model). Otherwise it may be a push: steep (its steepest 0.1 s, kept up for
0.2 s, would make up the change; a weave oscillation is rounder), not the swing back from the last strike; and
its free response starts at the extremum of the lean rate, or where its level is first reached when it then
stays.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import deque

import numpy as np

from tms_fit.strikes.classification import (
    LEAST_SAMPLES,
    MEAN_LENGTH_NS,
    SWING_BACK,
    DetectorHistory,
    classify_kink,
    classify_swing,
    is_swing_back,
)
from tms_fit.strikes.strike import NANOSECONDS, Rejected, Strike
from tms_fit.strikes.thresholds import StrikeThresholds

LONGEST_GAP_S = 0.15  # without samples; across a longer one no change is known to be sudden
BIN_LENGTH_NS = 5_000_000  # [ns]; samples closer than this are averaged for the search
HISTORY_NS = 2 * NANOSECONDS  # [ns] of samples for the classification of a change
NOISE_FACTOR = 6.0  # least change per noise


class StrikeDetector:
    """Strikes in a stream of lean rates; the result depends on the samples alone."""

    def __init__(self, settings: StrikeThresholds | None = None) -> None:
        self._settings = settings or StrikeThresholds()
        self._raw: deque[tuple[int, float]] = deque()  # samples [ns], [rad/s]
        self._bin: list[tuple[int, float]] = []  # samples of the bin that is open
        # Lists, since places in them are found by halving; as long as twice what is kept, see _append.
        self._time: list[int] = []  # [ns] bins
        self._rate: list[float] = []  # [rad/s] bins
        self._mean: list[float] = []  # [rad/s] running means
        self._memory: list[float] = []  # fading memory of swings, after each bin
        self._kinks: list[float] = []  # [rad/s]
        self._swung: tuple[int, float] | None = None  # candidate swing: when [ns], threshold [rad/s]
        self._kinked: tuple[int, float] | None = None  # the same for a kink
        self._last: deque[Strike] = deque(maxlen=2)
        self.rejected: deque[Rejected] = deque(maxlen=200)

    @property
    def latency(self) -> float:
        """Seconds after the start of a free response until it is reported, at most."""
        return 2.0 * self._settings.rise

    @property
    def least_change(self) -> float:
        """Change of the lean rate [rad/s] that a strike makes at least."""
        return self._settings.least_change

    def push(self, time_ns: int, lean_rate: float) -> Strike | None:
        """Process one sample (ascending times, [rad/s]); return the strike that it completes, if any."""
        if not math.isfinite(lean_rate):
            return None
        strike = None
        if self._raw and time_ns - self._raw[-1][0] > LONGEST_GAP_S * NANOSECONDS:
            self._close_bin()
            strike = self._classify()  # on what there is; across the gap no change is known to be sudden
            self._clear()
        if self._bin and time_ns - self._bin[0][0] >= BIN_LENGTH_NS:
            self._close_bin()
            candidates = [one[0] for one in (self._swung, self._kinked) if one]
            if candidates and time_ns - max(candidates) >= self._settings.rise * NANOSECONDS:
                strike = self._classify()
        self._bin.append((time_ns, lean_rate))
        self._raw.append((time_ns, lean_rate))
        while self._raw[-1][0] - self._raw[0][0] > HISTORY_NS:
            self._raw.popleft()
        return strike

    def withdraw(self, why: str) -> None:
        """Withdraw the last strike, with the reason."""
        strike = self._last.pop()
        self.rejected.append(Rejected(strike.time_ns, strike.change, why))

    def _clear(self) -> None:
        self._bin.clear()
        for series in (self._raw, self._time, self._rate, self._mean, self._memory, self._kinks):
            series.clear()
        self._swung = self._kinked = None

    def _close_bin(self) -> None:
        """Process the open bin; note candidates."""
        if not self._bin:
            return
        (time_ns, rate), count = self._bin[0], len(self._bin)
        if count > 1:
            time_ns += sum(when - time_ns for when, _ in self._bin) // count
            rate = sum(value for _, value in self._bin) / count
        self._bin.clear()
        mean = self._running_mean(time_ns, rate)
        swing, earlier = self._swing(time_ns, mean), self._earlier_memory(time_ns)
        kink = self._kink(time_ns, mean)
        self._append(time_ns, rate, mean, swing, kink)
        if len(self._time) > LEAST_SAMPLES:
            self._note_candidates(time_ns, swing, earlier, abs(kink))

    def _running_mean(self, time_ns: int, rate: float) -> float:
        """Mean over 50 ms; where these aren't whole samples, the first and the last count in part."""
        first = bisect_right(self._time, time_ns - MEAN_LENGTH_NS)
        recent = self._rate[first:]
        if not recent:
            return rate
        recent.append(rate)
        spacing = (time_ns - self._time[first]) / (len(recent) - 1)
        excess = min(max(len(recent) - MEAN_LENGTH_NS / spacing, 0.0), 1.0)
        return (sum(recent) - 0.5 * excess * (recent[0] + rate)) / (len(recent) - excess)

    def _note_candidates(self, time_ns: int, swing: float, earlier: float, kink: float) -> None:
        """Note the first swing and the first kink beyond their thresholds."""
        least = self._settings.least_change
        # The noise, a median, comes last: a quiet ride hardly ever needs it.
        if self._kinked is None and kink > least and kink > self._usual_kink():
            self._kinked = (time_ns, max(least, self._usual_kink()))
        if self._swung is None and swing > max(least, earlier):
            noise = NOISE_FACTOR * self._noise_of_means()
            if swing > noise:
                self._swung = (time_ns, max(least, earlier, noise))

    def _swing(self, time_ns: int, mean: float) -> float:
        """Largest change from any mean of the last `rise` seconds to this one."""
        since = bisect_left(self._time, time_ns - self._settings.rise * NANOSECONDS)
        earlier = self._mean[since:]
        return max(mean - min(earlier), max(earlier) - mean, 0.0) if earlier else 0.0

    def _kink(self, time_ns: int, mean: float) -> float:
        """The mean now less what the two means of the 100 ms before it lead to."""
        jitter = 1_000_000  # [ns] of stamps
        one = bisect_right(self._time, time_ns - MEAN_LENGTH_NS + jitter) - 1
        other = bisect_right(self._time, time_ns - 2 * MEAN_LENGTH_NS + jitter, 0, max(one, 0)) - 1
        return mean - 2.0 * self._mean[one] + self._mean[other] if other >= 0 else 0.0

    def _earlier_memory(self, time_ns: int) -> float:
        """Memory of the swings as it stood before the present change can have begun, faded until now."""
        row = bisect_left(self._time, time_ns - self._settings.rise * NANOSECONDS) - 1
        if row < 0:
            return 0.0
        age = (time_ns - self._time[row]) / NANOSECONDS
        return self._memory[row] * math.exp(-age / self._settings.memory)

    def _append(self, time_ns: int, rate: float, mean: float, swing: float, kink: float) -> None:
        if self._time:
            fade = math.exp(-(time_ns - self._time[-1]) / NANOSECONDS / self._settings.memory)
            swing = max(swing, self._memory[-1] * fade)
        self._time.append(time_ns)
        self._rate.append(rate)
        self._mean.append(mean)
        self._memory.append(swing)
        self._kinks.append(kink)
        if time_ns - self._time[0] > 2 * HISTORY_NS:  # seldom, since all that stays is moved
            old = self._first_kept()
            for series in (self._time, self._rate, self._mean, self._memory, self._kinks):
                del series[:old]

    def _first_kept(self) -> int:
        """Row of the first bin for the classification of a change."""
        return bisect_left(self._time, self._time[-1] - HISTORY_NS)

    def _usual_kink(self) -> float:
        """Six times the standard deviation of the kinks, from their median size."""
        return NOISE_FACTOR * 1.4826 * float(np.median(np.abs(np.array(self._kinks[self._first_kept() :]))))

    def _noise_of_means(self) -> float:
        """Standard deviation of the running means: a kink of white noise has six times their variance."""
        return self._usual_kink() / NOISE_FACTOR / math.sqrt(6.0)

    def _classify(self) -> Strike | None:
        """The strike among the candidates, if there is one."""
        swung, kinked, self._swung, self._kinked = self._swung, self._kinked, None, None
        if not (swung or kinked):
            return None
        history = self._history()
        strike: Strike | Rejected | None = classify_kink(history, *kinked, self._settings) if kinked else None
        if strike is None and swung:
            strike = classify_swing(history, *swung, self._settings)
            last = self._last[-1] if self._last else None
            if isinstance(strike, Strike) and is_swing_back(last, strike, self._settings):
                strike = Rejected(strike.time_ns, strike.change, SWING_BACK)
        if isinstance(strike, Rejected):
            self.rejected.append(strike)
            return None
        if strike is not None:
            self._last.append(strike)
        return strike

    def _history(self) -> DetectorHistory:
        first = self._first_kept()
        return DetectorHistory(
            time=np.array([when for when, _ in self._raw], dtype=np.int64),
            rate=np.array([rate for _, rate in self._raw]),
            bin_time=np.array(self._time[first:], dtype=np.int64),
            bin_rate=np.array(self._rate[first:]),
            bin_mean=np.array(self._mean[first:]),
            kink=np.array(self._kinks[first:]),
            last=self._last[-1] if self._last else None,
        )
