"""Hypothesis tests on one free response, each against the model with one assumption relaxed.

A hypothesis states that a parameter has a certain value (no deceleration, no steer rate, no pitch). The wider
model frees it; the test is Wald's, estimate less hypothesis per standard error, by Student's t, in the noise
that the wider model leaves: if the effect is real, the narrower model's residuals are coloured by it. Beside
it stand the differences of AIC and BIC, each from the model that the hypothesis describes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc, stdtr
from tms_model import Bicycle

from tms_fit.diagnostics.residual_tests import SIGNIFICANCE_LEVEL, probability
from tms_fit.estimate import Estimate
from tms_fit.estimators.least_squares import fit_window
from tms_fit.least_squares.model_selection import specify_model
from tms_fit.noise import ar
from tms_fit.noise.ar_process import ARChannelNoise, grid_places
from tms_fit.noise.colored import ColoredNoise
from tms_fit.response.prediction import predict_by
from tms_fit.settings import Settings
from tms_fit.speed_profile import constant_speed
from tms_fit.window import Window

SLIP = 0.2  # [s] after a strike in which the front wheel may slip


@dataclass(frozen=True)
class HypothesisTest:
    """One hypothesis and its test."""

    hypothesis: str  # such as 'constant speed'
    parameter: str  # of the wider model
    value: float  # by the wider model, SI
    std: float
    assumed: float  # by the hypothesis
    statistic: float  # (value - assumed) / std; NaN where the data can't decide
    p_value: float  # NaN where the data can't decide
    delta_aic: float  # of the wider model less that of the narrower; negative favours the wider
    delta_bic: float
    sentence: str

    @property
    def rejected(self) -> bool:
        """Whether the data reject the hypothesis."""
        return self.p_value < SIGNIFICANCE_LEVEL


def run_hypothesis_tests(window: Window, settings: Settings) -> tuple[HypothesisTest, ...]:
    """Tests of all hypotheses on one window; those whose parameter is free or fixed already are left out.

    Parameters that the data alone would free are tested here, so they are not freed beforehand.
    """
    settings = replace(settings, free=specify_model(window, settings).free)
    narrow = fit_window(window, settings)
    if not narrow.names:
        return ()
    return tuple(found for test in TESTS if (found := test(window, settings, narrow)) is not None)


def impulse_ratio(bicycle: Bicycle) -> float:
    """Steer rate per lean rate right after a pure roll impulse: M q' = J (1, 0)."""
    rates = np.linalg.solve(bicycle.mass, [1.0, 0.0])
    return float(rates[1] / rates[0])


def _no_slip(window: Window, settings: Settings, narrow: Estimate) -> HypothesisTest | None:
    """Whether the first 0.2 s agree with the rest: Chow's test, on residuals whitened where coloured.

    G. C. Chow, Econometrica 28 (1960), doi 10.2307/1910133: residual sums with and without the early samples.
    Colored noise is estimated from the rest.
    """
    early = window.time + window.delay < SLIP
    absent = np.where(early, np.nan, 0.0)
    late = replace(window, lean_rate=window.lean_rate + absent, yaw_rate=window.yaw_rate + absent)
    rest = fit_window(late, replace(settings, free=narrow.names))
    if rest.status != "ok" or narrow.sample_count <= rest.sample_count:  # slip is left out already
        return None
    count = narrow.sample_count - rest.sample_count
    own = float(np.nansum(rest.residual**2))
    more = max(float(np.nansum(narrow.residual**2)) - own, 0.0)
    size = math.sqrt(more / count)
    if rest.noise_model != "white":
        own, more = _white_squares(window, narrow, late, rest)
    statistic = more / count / (own / rest.degrees_of_freedom)
    p = float(fdtrc(count, max(rest.degrees_of_freedom, 1), statistic))
    said = f"the first {SLIP:g} s are off the rest by {size:.3f} rad/s"
    sentence = (
        f"no slip at the strike is rejected ({probability(p)}); {said}"
        if p < SIGNIFICANCE_LEVEL
        else f"no slip at the strike is not rejected ({probability(p)})"
    )
    nan = float("nan")
    return HypothesisTest("no slip at the strike", "slip", size, nan, 0.0, statistic, p, nan, nan, sentence)


def _white_squares(window: Window, narrow: Estimate, late: Window, rest: Estimate) -> tuple[float, float]:
    """Squares of the rest's whitened residuals, and how much larger they are with the early samples."""
    predicted, jacobian = predict_by(window, narrow)
    residual = window.measured - predicted
    kept = np.isfinite(late.measured)
    shown = ar.fit(late.time, np.where(kept, rest.residual, np.nan), jacobian)
    places = grid_places(window.time)
    good = np.isfinite(window.measured)
    channels = {}
    for c, noise in shown.channels.items():
        assert isinstance(noise, ARChannelNoise)
        own = places[good[:, c]]
        channels[c] = ARChannelNoise(noise.process, noise.std, own - own[0], int(own[-1] - own[0]) + 1)
    squares = []
    for model in (shown, ColoredNoise(good, {}, channels)):
        matrix, target = model.rows(jacobian), model.rows(residual)
        left = target - matrix @ np.linalg.lstsq(matrix, target, rcond=None)[0]
        squares.append(float(left @ left))
    return squares[0], max(squares[1] - squares[0], 0.0)


def _constant_speed(window: Window, settings: Settings, narrow: Estimate) -> HypothesisTest | None:
    """Whether the rates alone, without a speed sensor, show that the speed falls."""
    name = "rolling_resistance"
    if name in settings.fixed or (name in narrow.names and not window.speed.extrapolated):
        return None
    steady = replace(window, speed=constant_speed(window.start_speed, window.speed.std))
    free = tuple(dict.fromkeys((*(one for one in narrow.names if one != name), "speed")))
    fixed = {name: value for name, value in settings.fixed.items() if name != "speed"}
    at_constant = replace(settings, free=free, fixed=fixed, priors={}, speed_model="constant")
    wider = replace(at_constant, free=(*free, name))
    return _wald_test(
        "constant speed",
        name,
        (0.0, 0.0),
        fit_window(steady, at_constant),
        fit_window(steady, wider),
        lambda value, std: f"decelerating with C_r = {value:.4f} +- {std:.4f}",
    )


def _no_steer_rate(window: Window, settings: Settings, narrow: Estimate) -> HypothesisTest | None:
    return _test_freed(
        "no steer rate at the start",
        "initial_steer_rate",
        (window, settings, narrow),
        lambda value, std: f"a steer rate of {value:.3f} +- {std:.3f} rad/s",
    )


def _impulse_steer_rate(window: Window, settings: Settings, narrow: Estimate) -> HypothesisTest | None:
    """Whether the steer rate is the one that a roll impulse on a freely steering bicycle gives."""
    name = "initial_steer_rate"
    if "initial_lean_rate" not in narrow.names or {name} & {*settings.fixed, *settings.priors}:
        return None
    wide = narrow if name in narrow.names else fit_window(window, _widened(settings, narrow, name))
    if wide.status != "ok":
        return None
    ratio = impulse_ratio(window.bicycle)
    weights = np.array([{name: 1.0, "initial_lean_rate": -ratio}.get(one, 0.0) for one in wide.names])
    assumed = ratio * wide.parameters["initial_lean_rate"]
    value, std = wide.parameters[name], math.sqrt(float(weights @ wide.covariance @ weights))
    return _hypothesis_test(
        f"the steer rate of a roll impulse, {ratio:.2f} times the lean rate",
        (name, value, std, assumed),
        wide,
        _lifted_constraint(wide, (value - assumed) / std),
        f"a steer rate of {value:.3f} +- {wide.std[wide.names.index(name)]:.3f} rad/s",
    )


def _no_pitch(window: Window, settings: Settings, narrow: Estimate) -> HypothesisTest | None:
    return _test_freed(
        "a level sensor",
        "mounting_pitch",
        (window, settings, narrow),
        lambda value, std: f"one pitched by {math.degrees(value):.2f} +- {math.degrees(std):.2f} deg",
    )


def _no_feedback(window: Window, settings: Settings, narrow: Estimate) -> HypothesisTest | None:
    if window.steer_torque is not None:
        return None
    return _test_freed(
        "no steer feedback" if not window.lean_rate_gain else "the feedback gain as commanded",
        "lean_rate_gain",
        (window, settings, narrow),
        lambda value, std: f"a gain of {value:.4g} +- {std:.2g} N m s/rad",
        (window.lean_rate_gain, window.lean_rate_gain_std),
    )


def _no_damping(window: Window, settings: Settings, narrow: Estimate) -> HypothesisTest | None:
    return _test_freed(
        "no more steer damping than the bicycle has",
        "steer_damper",
        (window, settings, narrow),
        lambda value, std: f"{value:.4g} +- {std:.2g} N m s/rad more",
    )


def _test_freed(
    hypothesis: str,
    name: str,
    fit: tuple[Window, Settings, Estimate],
    words: Callable[[float, float], str],
    assumed: tuple[float, float] = (0.0, 0.0),
) -> HypothesisTest | None:
    """Test of a parameter that the wider model frees; assumed: value and standard deviation by hypothesis."""
    window, settings, narrow = fit
    if name in {*narrow.names, *settings.fixed}:
        return None
    wide = fit_window(window, _widened(settings, narrow, name))
    return _wald_test(hypothesis, name, assumed, narrow, wide, words)


def _widened(settings: Settings, narrow: Estimate, name: str) -> Settings:
    return replace(settings, free=(*narrow.names, name))


def _wald_test(
    hypothesis: str,
    name: str,
    assumed: tuple[float, float],
    narrow: Estimate,
    wide: Estimate,
    words: Callable[[float, float], str],
) -> HypothesisTest:
    if wide.status != "ok":
        nan = float("nan")
        text = f"{hypothesis}: the data can't tell ({wide.message})"
        return HypothesisTest(hypothesis, name, nan, nan, assumed[0], nan, nan, nan, nan, text)
    value, std = wide.parameters[name], float(wide.std[wide.names.index(name)])
    differences = wide.aic - narrow.aic, wide.bic - narrow.bic
    found = (name, value, math.hypot(std, assumed[1]), assumed[0])
    return _hypothesis_test(hypothesis, found, wide, differences, words(value, std))


def _lifted_constraint(wide: Estimate, statistic: float) -> tuple[float, float]:
    """Differences of AIC and BIC by a linear constraint that the wider model lifts, from its t statistic.

    The sum of squares falls from 1 + t^2 / (degrees of freedom) to 1: exact in white noise.
    """
    count = wide.sample_count
    gain = count * math.log1p(statistic**2 / max(wide.degrees_of_freedom, 1))
    return 2.0 - gain, math.log(count) - gain


def _hypothesis_test(
    hypothesis: str,
    found: tuple[str, float, float, float],
    wide: Estimate,
    differences: tuple[float, float],  # of AIC and BIC
    alternative: str,
) -> HypothesisTest:
    name, value, std, assumed = found
    statistic = (value - assumed) / std
    p = 2.0 * float(stdtr(max(wide.degrees_of_freedom, 1), -abs(statistic)))
    sentence = (
        f"{hypothesis} is rejected ({probability(p)}); {alternative} is not"
        if p < SIGNIFICANCE_LEVEL
        else f"{hypothesis} is not rejected ({probability(p)}); the wider model finds {alternative}"
    )
    return HypothesisTest(
        hypothesis,
        name,
        value,
        std,
        assumed,
        statistic,
        p,
        *differences,
        sentence,
    )


TESTS = (
    _constant_speed,
    _no_steer_rate,
    _impulse_steer_rate,
    _no_slip,
    _no_pitch,
    _no_feedback,
    _no_damping,
)
