"""Signs of model misspecification. Confidence intervals do not cover this error.

Autocorrelated residuals: an interval for autocorrelated noise covers such noise, not a wrong model. The
additional parameter that reduces the residuals most is named; `tms_fit.diagnostics.hypothesis_tests` tests
whether it is needed.

Implausible values: with enough free parameters the residuals of a wrong model are white as well, but then a
gyroscope's bias or an angle at the start is outside its plausible range.

Readings beyond the stated range of the gyroscope: they were not clipped there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from tms_model.bicycle import Array

from tms_fit.estimate import Estimate
from tms_fit.estimators.least_squares import fit_window
from tms_fit.least_squares.irls import only_rounding
from tms_fit.noise.ar import is_autocorrelated
from tms_fit.parameters import PARAMETERS
from tms_fit.settings import Settings
from tms_fit.window import Window

CANDIDATES = (
    "initial_steer_rate",
    "initial_lean",
    "initial_steer",
    "rolling_resistance",
    "mounting_pitch",
    "lean_rate_gain",
    "steer_damper",
)
LARGEST_MOUNTING_PITCH = 0.1  # [rad] of a sensor mounted without stating it
LEAST_STD_REDUCTION = 0.1  # of the residuals' standard deviation, by a parameter to be named
LEAST_BIC_REDUCTION = 10.0  # of BIC under white noise, by a parameter to be named
PLAUSIBLE_LIMITS = {  # largest absolute values [rad/s], [rad], and what of
    "lean_rate_bias": (0.05, "a gyroscope's bias"),
    "yaw_rate_bias": (0.05, "a gyroscope's bias"),
    "initial_lean": (0.5, "an angle for small-angle equations"),
    "initial_steer": (0.5, "an angle for small-angle equations"),
}
# Largest rates per stated range: lean rate of a sensor mounted some degrees off, yaw rate as levelled.
RANGE_MARGINS = np.array([1.1, 1.5])
LIMIT_STANDARD_ERRORS = 3.0  # by which a value exceeds its limit


@dataclass(frozen=True)
class Misspecification:
    """Reason why the error of an estimate may exceed its interval."""

    parameter: str  # that reduces the residuals most, or has an implausible value; empty: none
    sentence: str


def find_misspecification(window: Window, settings: Settings, estimate: Estimate) -> Misspecification | None:
    """Misspecification that an estimate shows; None where it shows none."""
    if estimate.status != "ok":
        return None
    reasons = [_beyond_range(window, settings)]
    if not only_rounding(window.measured, estimate.residual):
        reasons += [
            _autocorrelated_residuals(window, settings, estimate),
            _implausible_value(settings, estimate),
        ]
    found = [one for one in reasons if one]
    if not found:
        return None
    names = [one.parameter for one in found if one.parameter]
    text = "; ".join(one.sentence for one in found)
    return Misspecification(names[0] if names else "", f"doubtful: {text}; --hypotheses tests more")


def _beyond_range(window: Window, settings: Settings) -> Misspecification | None:
    """Readings larger than the stated range of the gyroscope."""
    stated = settings.gyroscope_range
    if stated is None or settings.saturation == "use":
        return None
    sizes = np.abs(window.measured)
    above = sizes > RANGE_MARGINS * stated
    count = int(np.count_nonzero(above))
    if not count:
        return None
    what = {"drop": "left out", "censor": "taken as at least that large"}[settings.saturation]
    return Misspecification(
        "",
        f"{count} readings are larger than the stated gyroscope range of {stated:g} rad/s, up to"
        f" {sizes[above].max():.3g}: they were not clipped there, and were {what} all the same; state the"
        " sensor's own range",
    )


def _autocorrelated_residuals(
    window: Window, settings: Settings, estimate: Estimate
) -> Misspecification | None:
    """Autocorrelated residuals, and the additional parameter that reduces them most."""
    if not is_autocorrelated(_model_residuals(estimate)):
        return None
    start = "neighbouring residuals are alike, and the interval doesn't cover a wrong model"
    narrow = _refit((), window, settings, estimate)
    fits = {
        name: _refit((name,), window, settings, estimate) for name in _candidates(window, settings, estimate)
    }
    wider = {name: fit for name, fit in fits.items() if fit is not None and _plausible(name, fit)}
    if narrow is not None and wider:
        name, best = min(wider.items(), key=lambda one: one[1].bic)
        falls = best.residual_std < (1.0 - LEAST_STD_REDUCTION) * narrow.residual_std
        if falls and best.bic < narrow.bic - LEAST_BIC_REDUCTION:
            return Misspecification(name, f"{start}; {_effect_sentence(name, narrow, best)}")
    return Misspecification("", f"{start}; no single unknown more explains it")


def _implausible_value(settings: Settings, estimate: Estimate) -> Misspecification | None:
    """The parameter farthest beyond its plausible limit, unless it has a prior."""
    found: dict[str, tuple[float, str]] = {}
    for name, value, std in zip(estimate.names, estimate.values, estimate.std, strict=True):
        if name not in PLAUSIBLE_LIMITS or name in settings.priors:
            continue
        limit, what = PLAUSIBLE_LIMITS[name]
        beyond = (abs(float(value)) - limit) / limit
        if abs(float(value)) > limit + LIMIT_STANDARD_ERRORS * float(std):
            text = (
                f"{name} {value:+.3g} +- {std:.2g} is too large for {what} and may stand in for something"
                " that the model misses, which no interval covers"
            )
            found[name] = (beyond, text)
    if not found:
        return None
    worst = max(found, key=lambda name: found[name][0])
    return Misspecification(worst, found[worst][1])


def _model_residuals(estimate: Estimate) -> Array:
    """Residuals (n, 2) of the model, without an oscillation that the noise model explains."""
    return estimate.whitened if estimate.noise_model == "oscillator" else estimate.residual


def _candidates(window: Window, settings: Settings, estimate: Estimate) -> list[str]:
    """Parameters that were neither estimated nor fixed, and that the recording doesn't determine."""
    excluded = {*estimate.names, *settings.fixed}
    if not window.speed.constant:
        excluded.add("rolling_resistance")
    if window.steer_torque is not None or window.lean_rate_gain:  # recorded
        excluded.add("lean_rate_gain")
    if not np.isfinite(window.yaw_rate).any():
        excluded.add("mounting_pitch")
    return [name for name in CANDIDATES if name not in excluded]


def _refit(names: tuple[str, ...], window: Window, settings: Settings, estimate: Estimate) -> Estimate | None:
    """The fit with more free parameters under white noise; None where it fails."""
    free = tuple(name for name in (*estimate.names, *names) if name in PARAMETERS)
    fit = fit_window(window, replace(settings, free=free, noise="white", oscillator=()))
    return fit if fit.status == "ok" else None


def _plausible(name: str, fit: Estimate) -> bool:
    return name != "mounting_pitch" or abs(fit.parameters[name]) < LARGEST_MOUNTING_PITCH


def _effect_sentence(name: str, narrow: Estimate, best: Estimate) -> str:
    value, std = best.parameters[name], float(best.std[best.names.index(name)])
    text = (
        f"with {name} free ({value:.3g} +- {std:.2g}) they fall from {narrow.residual_std:.3f} to"
        f" {best.residual_std:.3f} rad/s"
    )
    if "initial_lean_rate" not in best.names:
        return text
    before, after = (one.parameters["initial_lean_rate"] for one in (narrow, best))
    return f"{text} and the initial lean rate is {after:+.3f}, not {before:+.3f}"
