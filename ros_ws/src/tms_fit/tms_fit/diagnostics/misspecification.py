"""What speaks for a wrong model, which moves an estimate by as much as it likes; no interval covers that.

Coloured residuals: an interval for coloured noise covers what a noise like this does to the estimate. Beside
it the plain answer says which one unknown more would explain the most; whether it is missing,
`tms_fit.diagnostics.hypothesis_tests` tests.

Unknowns that stand in for what is missing: with enough of them free the residuals of a wrong model are white
as well, but then a gyroscope's bias or an angle at the start comes out as none can be.

Readings beyond the range that somebody states: those were not clipped, and aren't what they are taken for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from tms_model.bicycle import Array

from tms_fit.estimate import Estimate
from tms_fit.estimators.least_squares import fit_window
from tms_fit.least_squares.irls import only_rounding
from tms_fit.noise.ar import is_autocorrelated
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
STEEPEST = 0.1  # [rad] of mounting pitch; nobody mounts a sensor worse without knowing
LEAST_SHARE = 0.1  # of the residuals' standard deviation that an unknown must explain to be named
LEAST_BIC = 10.0  # by which it must lower BIC under white noise
LARGEST = {  # that an unknown can be, and what it then is [rad/s], [rad]
    "lean_rate_bias": (0.05, "a gyroscope's bias"),
    "yaw_rate_bias": (0.05, "a gyroscope's bias"),
    "initial_lean": (0.5, "an angle for small-angle equations"),
    "initial_steer": (0.5, "an angle for small-angle equations"),
}
ABOVE = np.array(
    [1.1, 1.5]
)  # of the stated range: lean rate by a mount some degrees off, yaw rate as levelled
BEYOND = 3.0  # standard errors by which it must be larger


@dataclass(frozen=True)
class Misspecification:
    """Why an estimate may be wrong by more than its interval."""

    parameter: str  # that would explain the most of the residuals, or that can't be as found; empty: none
    sentence: str


def doubt(window: Window, settings: Settings, estimate: Estimate) -> Misspecification | None:
    """What makes an estimate doubtful; None where nothing does."""
    if estimate.status != "ok":
        return None
    reasons = [_beyond_range(window, settings)]
    if not only_rounding(window.measured, estimate.residual):
        reasons += [_alike(window, settings, estimate), _impossible(settings, estimate)]
    found = [one for one in reasons if one]
    if not found:
        return None
    names = [one.parameter for one in found if one.parameter]
    said = "; ".join(one.sentence for one in found)
    return Misspecification(names[0] if names else "", f"doubtful: {said}; --hypotheses tests more")


def _beyond_range(window: Window, settings: Settings) -> Misspecification | None:
    """Readings that a gyroscope of the stated range doesn't give: that isn't where they are clipped."""
    stated = settings.gyroscope_range
    if stated is None or settings.saturation == "use":
        return None
    sizes = np.abs(window.measured)
    above = sizes > ABOVE * stated
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


def _alike(window: Window, settings: Settings, estimate: Estimate) -> Misspecification | None:
    """Neighbouring residuals that are alike, and which one unknown more would explain the most of them."""
    if not is_autocorrelated(_unexplained(estimate)):
        return None
    start = "neighbouring residuals are alike, and the interval doesn't cover a wrong model"
    narrow = _with((), window, settings, estimate)
    fits = {
        name: _with((name,), window, settings, estimate) for name in _candidates(window, settings, estimate)
    }
    wider = {name: fit for name, fit in fits.items() if fit is not None and _plausible(name, fit)}
    if narrow is not None and wider:
        name, best = min(wider.items(), key=lambda one: one[1].bic)
        falls = best.residual_std < (1.0 - LEAST_SHARE) * narrow.residual_std
        if falls and best.bic < narrow.bic - LEAST_BIC:
            return Misspecification(name, f"{start}; {_in_words(name, narrow, best)}")
    return Misspecification("", f"{start}; no single unknown more explains it")


def _impossible(settings: Settings, estimate: Estimate) -> Misspecification | None:
    """The unknown that is the farthest beyond what it can be, if nobody said that it is."""
    said: dict[str, tuple[float, str]] = {}
    for name, value, std in zip(estimate.names, estimate.values, estimate.std, strict=True):
        if name not in LARGEST or name in settings.priors:
            continue
        limit, what = LARGEST[name]
        beyond = (abs(float(value)) - limit) / limit
        if abs(float(value)) > limit + BEYOND * float(std):
            text = (
                f"{name} {value:+.3g} +- {std:.2g} is too large for {what} and may stand in for something"
                " that the model misses, which no interval covers"
            )
            said[name] = (beyond, text)
    if not said:
        return None
    worst = max(said, key=lambda name: said[name][0])
    return Misspecification(worst, said[worst][1])


def _unexplained(estimate: Estimate) -> Array:
    """Residuals (n, 2), whatever the noise model; an oscillation beyond the bicycle's own is explained."""
    return estimate.whitened if estimate.noise_model == "oscillator" else estimate.residual


def _candidates(window: Window, settings: Settings, estimate: Estimate) -> list[str]:
    """Parameters that were neither found nor fixed, and that the recording doesn't tell itself."""
    told = {*estimate.names, *settings.fixed}
    if not window.speed.constant:
        told.add("rolling_resistance")
    if window.steer_torque is not None or window.lean_rate_gain:  # recorded
        told.add("lean_rate_gain")
    if not np.isfinite(window.yaw_rate).any():
        told.add("mounting_pitch")
    return [name for name in CANDIDATES if name not in told]


def _with(names: tuple[str, ...], window: Window, settings: Settings, estimate: Estimate) -> Estimate | None:
    """The fit with more unknowns under white noise; None where it gives no answer."""
    fit = fit_window(window, replace(settings, free=(*estimate.names, *names), noise="white", oscillator=()))
    return fit if fit.status == "ok" else None


def _plausible(name: str, fit: Estimate) -> bool:
    return name != "mounting_pitch" or abs(fit.parameters[name]) < STEEPEST


def _in_words(name: str, narrow: Estimate, best: Estimate) -> str:
    value, std = best.parameters[name], float(best.std[best.names.index(name)])
    text = (
        f"with {name} free ({value:.3g} +- {std:.2g}) they fall from {narrow.residual_std:.3f} to"
        f" {best.residual_std:.3f} rad/s"
    )
    if "initial_lean_rate" not in best.names:
        return text
    before, after = (one.parameters["initial_lean_rate"] for one in (narrow, best))
    return f"{text} and the initial lean rate is {after:+.3f}, not {before:+.3f}"
