"""Estimator of the supplement, chapter 10: initial lean rate from the lean rate, at constant speed."""

from __future__ import annotations

from dataclasses import replace

from tms_fit.estimate import Estimate
from tms_fit.estimators.least_squares import fit_model
from tms_fit.least_squares.model_selection import specify_model
from tms_fit.parameters import LINEAR
from tms_fit.settings import Settings
from tms_fit.speed_profile import constant_speed
from tms_fit.window import Window

FREE = ("initial_lean_rate",)
ASSUMPTIONS = (
    "a start upright and straight, a level and unbiased sensor, a constant speed and white noise are taken"
    " for true, so that the interval is too short where they aren't"
)


def estimate(window: Window, settings: Settings) -> Estimate:
    """Estimate of the initial lean rate; lean, steer and steer rate start at zero for any settings."""
    curve = window.speed
    middle = curve.origin if curve.extrapolated or not len(window.time) else 0.5 * float(window.time[-1])
    constant = replace(window, speed=constant_speed(float(curve.at(middle)), curve.std))
    kept = (*LINEAR, "speed", "lean_rate_gain")
    fixed = {k: v for k, v in settings.fixed.items() if k in kept and k not in FREE}
    plain = replace(
        settings,
        free=FREE,
        fixed=fixed,
        priors={},
        channels=("lean_rate",),
        speed_model="constant",
        noise="white",
        oscillator=(),
        loss="squares",
    )
    found = fit_model("som2011", specify_model(constant, plain), plain)
    if found.status != "ok":
        return found
    words = found.message.replace("linear least squares", "least squares as in 2011")
    return replace(found, message=f"{words}; {ASSUMPTIONS}")
