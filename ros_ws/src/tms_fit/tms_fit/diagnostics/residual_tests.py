"""Residual tests of a fit, each with one sentence.

They test the whitened residuals, which are white, of unit variance, if model and noise are right.

- Autocorrelation: Ljung and Box's Q (Biometrika 65 (1978), doi 10.1093/biomet/65.2.297); where samples are
  missing only the measured pairs of each lag count (Stoffer and Toloi, Stat. Prob. Lett. 13 (1992)).
- Tones: Fisher's exact test for the largest ordinate of the periodogram (Proc. R. Soc. A 125 (1929), doi
  10.1098/rspa.1929.0151).
- Normality: Jarque and Bera (Econ. Lett. 6 (1980)).
- Size: reduced chi-square, where the noise is stated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc
from tms_model.bicycle import Array

from tms_fit.diagnostics.stated_noise import StatedNoise
from tms_fit.estimate import Estimate
from tms_fit.parameters import CHANNELS
from tms_fit.window import Window

LARGEST_LAG_COUNT = 10  # of the Ljung-Box test, at most a fifth of the samples
SIGNIFICANCE_LEVEL = 1e-3  # probability below which a test fails
LEAST_SAMPLES = 20  # of a channel, for a test
SHIMMY_BAND_HZ = (12.0, 30.0)


@dataclass(frozen=True)
class ResidualTest:
    """One test on one channel."""

    name: str  # ljung_box, periodogram, normality, chi_square
    channel: str
    statistic: float
    p_value: float  # of a statistic as large as this if model and noise model are right
    sentence: str

    @property
    def passed(self) -> bool:
        """Whether the test does not reject the model."""
        return self.p_value >= SIGNIFICANCE_LEVEL


@dataclass(frozen=True)
class ResidualDiagnostics:
    """Tests of the residuals of one estimate."""

    tests: tuple[ResidualTest, ...]
    fit_percent: dict[str, float]  # per channel, NRMSE: 100 is perfect, 0 no better than the mean
    stated: StatedNoise | None = None  # None: the noise is not stated, their size is not tested

    @property
    def reduced_chi_square(self) -> dict[str, float]:
        """Mean square of the residuals per stated variance, by channel; empty where it is not stated."""
        return {test.channel: test.statistic for test in self.tests if test.name == "chi_square"}

    @property
    def size(self) -> str:
        """One sentence over the size of the residuals."""
        if self.stated is None:
            return "reduced chi-square: the noise is not stated; --noise-std RATE [rad/s] states it"
        found = ", ".join(
            f"{value:.2f} ({name.replace('_', ' ')})" for name, value in self.reduced_chi_square.items()
        )
        return f"reduced chi-square: {found or 'too few samples'}, for a noise of {self.stated.in_words}"

    @property
    def verdict(self) -> str:
        """One sentence over all tests."""
        failed = [test.sentence for test in self.tests if not test.passed]
        if not self.tests:
            return "too few samples to judge the residuals"
        return "; ".join(failed) if failed else "nothing in the residuals speaks against the model"


def diagnose_residuals(
    window: Window, estimate: Estimate, stated: StatedNoise | None = None
) -> ResidualDiagnostics:
    """Tests of an estimate's residuals; none where it has no values.

    stated: one sample's noise by the recording or the settings; without it, their size is not tested.
    """
    tests: list[ResidualTest] = []
    if estimate.names:
        fitted = _unknowns_per_channel(estimate)
        for channel, whitened, residual, unknowns in zip(
            CHANNELS, estimate.whitened.T, estimate.residual.T, fitted, strict=True
        ):
            if np.isfinite(whitened).sum() >= LEAST_SAMPLES:
                tests += [
                    _ljung_box_test(channel, whitened),
                    _periodogram_test(channel, window.time, whitened),
                    _normality_test(channel, whitened),
                ]
                if stated is not None and channel in stated.std:
                    tests.append(_chi_square_test(channel, residual, stated.std[channel], unknowns))
    return ResidualDiagnostics(tuple(tests), fit_percent(window, estimate) if estimate.names else {}, stated)


def ljung_box(values: Array, lags: int) -> tuple[float, float]:
    """Q and its probability for values (n,), NaN where missing, over `lags` lags."""
    good = np.isfinite(values)
    count = int(good.sum())
    centred = np.where(good, values - np.mean(values[good]), 0.0)
    power = float(centred @ centred)
    q = 0.0
    for lag in range(1, lags + 1):
        pairs = int((good[lag:] & good[:-lag]).sum())
        if pairs:
            correlation = float(centred[lag:] @ centred[:-lag]) / power * (count - lag) / pairs
            q += correlation**2 * pairs / (count - lag) / (count - lag)
    q *= count * (count + 2.0)
    return q, float(chdtrc(lags, q))


def fisher_g(power: Array) -> float:
    """Probability that the largest of m ordinates of white noise has such a share of their sum."""
    count = len(power)
    share = float(power.max() / power.sum())
    total = 0.0
    for j in range(1, min(count, math.floor(1.0 / share)) + 1):
        term = math.lgamma(count + 1) - math.lgamma(j + 1) - math.lgamma(count - j + 1)
        left = 1.0 - j * share
        if left <= 0.0:
            break
        size = math.exp(term + (count - 1) * math.log(left))
        total += size if j % 2 else -size
        if size < 1e-16:
            break
    return min(max(total, 0.0), 1.0)


def fit_percent(window: Window, estimate: Estimate) -> dict[str, float]:
    """100 (1 - |measured - predicted| / |measured - its mean|) per measured channel."""
    answer = {}
    for channel, measured, residual in zip(CHANNELS, window.measured.T, estimate.residual.T, strict=True):
        good = np.isfinite(measured) & np.isfinite(residual)
        if good.sum() > 1 and np.ptp(measured[good]) > 0.0:
            spread = np.linalg.norm(measured[good] - np.mean(measured[good]))
            answer[channel] = float(100.0 * (1.0 - np.linalg.norm(residual[good]) / spread))
    return answer


def probability(p_value: float) -> str:
    """A probability as text."""
    return "p < 1e-6" if p_value < 1e-6 else f"p = {p_value:.2g}"


def _ljung_box_test(channel: str, values: Array) -> ResidualTest:
    lags = max(1, min(LARGEST_LAG_COUNT, int(np.isfinite(values).sum()) // 5))
    q, p = ljung_box(values, lags)
    name = channel.replace("_", " ")
    said = (
        f"the {name}'s residuals remember those before (Ljung-Box Q = {q:.0f} over {lags} lags,"
        f" {probability(p)}): the model misses something, or the noise is coloured"
        if p < SIGNIFICANCE_LEVEL
        else f"the {name}'s residuals have no memory (Ljung-Box, {probability(p)})"
    )
    return ResidualTest("ljung_box", channel, q, p, said)


def _periodogram_test(channel: str, time: Array, values: Array) -> ResidualTest:
    spacing = float(np.median(np.diff(time)))
    rows = np.round((time - time[0]) / spacing).astype(int)  # missing samples leave holes, filled with zeros
    even = np.zeros(int(rows[-1]) + 1)
    even[rows] = np.nan_to_num(values - np.nanmean(values))
    power = np.abs(np.fft.rfft(even))[1:] ** 2
    frequencies = np.fft.rfftfreq(len(even), spacing)[1:]
    power = power[: (len(even) - 1) // 2]
    peak = float(frequencies[int(np.argmax(power))])
    p = fisher_g(power)
    name = channel.replace("_", " ")
    kind = "a shimmy" if SHIMMY_BAND_HZ[0] <= peak <= SHIMMY_BAND_HZ[1] else "an oscillation"
    said = (
        f"{kind} of {peak:.1f} Hz stands out of the {name}'s residuals ({probability(p)})"
        if p < SIGNIFICANCE_LEVEL
        else f"no frequency stands out of the {name}'s residuals ({probability(p)})"
    )
    return ResidualTest("periodogram", channel, peak, p, said)


def _jarque_bera(values: Array) -> float:
    """Statistic of Jarque and Bera: chi-square of two degrees of freedom where values (n,) are normal."""
    off = values - values.mean()
    variance = np.mean(off**2)
    skewness, kurtosis = np.mean(off**3) / variance**1.5, np.mean(off**4) / variance**2
    return float(len(off) / 6.0 * (skewness**2 + (kurtosis - 3.0) ** 2 / 4.0))


def _normality_test(channel: str, values: Array) -> ResidualTest:
    statistic = _jarque_bera(values[np.isfinite(values)])
    p = float(chdtrc(2, statistic))
    name = channel.replace("_", " ")
    said = (
        f"the {name}'s residuals are not normal (Jarque-Bera, {probability(p)}): outliers, or clipped samples"
        if p < SIGNIFICANCE_LEVEL
        else f"the {name}'s residuals look normal (Jarque-Bera, {probability(p)})"
    )
    return ResidualTest("normality", channel, statistic, p, said)


def _unknowns_per_channel(estimate: Estimate) -> list[float]:
    """Degrees of freedom that the fit takes from each channel: traces of the hat matrix, summing to all."""
    good = np.isfinite(estimate.residual)
    if not estimate.jacobian.size:
        return [len(estimate.names) / max(int(good.any(axis=0).sum()), 1)] * len(CHANNELS)
    basis, _ = np.linalg.qr(estimate.jacobian[good])
    share = np.zeros(good.shape)
    share[good] = np.sum(basis**2, axis=1)
    found: list[float] = share.sum(axis=0).tolist()
    return found


def _chi_square_test(channel: str, residual: Array, std: float, unknowns: float) -> ResidualTest:
    good = residual[np.isfinite(residual)]
    degrees = max(len(good) - unknowns, 1.0)
    reduced = float(np.sum(good**2)) / std**2 / degrees
    p = float(chdtrc(degrees, reduced * degrees))
    name = channel.replace("_", " ")
    said = (
        f"the {name}'s residuals are larger than the stated noise allows (reduced chi-square {reduced:.2f},"
        f" {probability(p)})"
        if p < SIGNIFICANCE_LEVEL
        else f"the {name}'s residuals are no larger than the stated noise (reduced chi-square {reduced:.2f})"
    )
    return ResidualTest("chi_square", channel, reduced, p, said)
