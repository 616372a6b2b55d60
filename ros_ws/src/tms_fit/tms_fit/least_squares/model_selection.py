"""Model selection: free parameters where the settings leave them open, and the reasons."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from tms_model.acceleration import coasting_loss

from tms_fit.estimate import Estimate
from tms_fit.least_squares.problem import Problem
from tms_fit.parameters import BIASES, DEFAULT_FREE, FRICTION, INITIAL, LINEAR, PARAMETERS, SLIP
from tms_fit.settings import Settings
from tms_fit.speed_profile import SPEED_STALE_AFTER_S, constant_speed
from tms_fit.window import Window, with_channels, without_saturated

COASTING_PARAMETERS = {"speed", "rolling_resistance"}
LONG_WINDOW_S = 2.0  # least window in which the rates alone determine a falling speed
DISTURBED_STARTS = (("initial_steer_rate",), ("initial_steer_rate", "initial_lean", "initial_steer"))


@dataclass(frozen=True, eq=False)
class ModelSpec:
    """Problem with the selections that specify it."""

    problem: Problem
    free: tuple[str, ...]  # in the order asked for
    noise: str  # noise model of NOISES, or 'auto'
    words: str  # for the message: empty, or beginning with a comma
    reasons: tuple[str, ...] = ()  # of selections by the data, a phrase each
    coasting: str = ""  # the reason of a free rolling resistance


def specify_model(window: Window, settings: Settings) -> ModelSpec:
    """Model that settings specify for a window, before any evidence from a fit."""
    window = with_channels(window, settings.channels)
    words = [_about_slip(window, settings)]
    if settings.slip_window:
        if settings.slip == "leave_out":
            window = _without_slip(window, settings.slip_window)
        else:
            window = replace(window, slip_window=settings.slip_window)
    saturated = 0 if window.saturated is None else int(np.count_nonzero(window.saturated))
    if settings.saturation == "drop":
        window = without_saturated(window)
    words.append(_about_saturation(saturated, settings))
    free, known = _free(window, settings), dict(settings.fixed)
    words.append(_about_speed(window, {*free, *known}))
    why = _coasting_reason(window, settings)
    return ModelSpec(
        problem=_problem(window, free, known, settings),
        free=free,
        noise=settings.noise,
        words="".join(words),
        reasons=(why,) if why else (),
        coasting=why,
    )


def _coasting_reason(window: Window, settings: Settings) -> str:
    """Reason why the rolling resistance is freed by default; empty where it isn't."""
    asked = settings.free is not None or settings.speed_model != "auto"
    given = {"rolling_resistance"} & {*settings.fixed, *settings.priors}
    if asked or given or not window.speed.extrapolated:
        return ""
    if window.speed.is_stale and "speed" not in settings.priors:
        within = f"within {SPEED_STALE_AFTER_S:g} s"
        return f"speed and rolling resistance found because no speed was measured {within}"
    return "rolling resistance found because the speed was not measured over the window"


def at_measured_speed(model: ModelSpec, settings: Settings) -> ModelSpec:
    """Model at the measured speed throughout, without the freed rolling resistance."""
    window, curve = model.problem.window, model.problem.window.speed
    constant = constant_speed(float(curve.coefficients[0]), curve.std, measured=True)
    found = (
        {"rolling_resistance"} if not curve.is_stale or "speed" in settings.priors else COASTING_PARAMETERS
    )
    free = tuple(name for name in model.free if name not in found)
    problem = _problem(replace(window, speed=constant), free, dict(settings.fixed), settings)
    return replace(model, problem=problem, free=free)


def with_nonlinear_fixed(model: ModelSpec, estimate: Estimate) -> ModelSpec:
    """Model with its nonlinear parameters fixed at the values of an estimate."""
    problem = model.problem
    fixed = {name: estimate.parameters[name] for name in problem.nonlinear}
    priors = {name: prior for name, prior in problem.priors.items() if name not in fixed}
    return replace(
        model, problem=replace(problem, nonlinear=(), known={**problem.known, **fixed}, priors=priors)
    )


def with_falling_speed(model: ModelSpec, settings: Settings) -> ModelSpec | None:
    """Model with speed and rolling resistance free; None where the speed is measured or specified."""
    window = model.problem.window
    asked = settings.free is not None or settings.speed_model != "auto"
    if asked or window.speed.measured or len(window.time) < 2 or window.time[-1] < LONG_WINDOW_S:
        return None
    if COASTING_PARAMETERS & {*settings.fixed, *model.free}:
        return None
    free = (*model.free, "speed", "rolling_resistance")
    why = "speed and rolling resistance found because a constant speed is far less likely"
    return _with_free(model, free, why, settings)


def with_disturbed_start(model: ModelSpec, settings: Settings) -> list[ModelSpec]:
    """Models with initial steer rate free, and with lean and steer as well, unless `free` is set.

    A strike that also turns the steering, or ends before the wheels roll again, disturbs the initial state.
    With a free rolling resistance the steer rate alone is not tried: a wrong resistance makes it resemble the
    full disturbance, and the interval would contain neither value.
    """
    if settings.free is not None:
        return []
    taken = {*settings.fixed, *model.free}
    rivals: list[ModelSpec] = []
    for names in DISTURBED_STARTS[-1:] if model.coasting else DISTURBED_STARTS:
        more = tuple(name for name in names if name not in taken)
        free = (*model.free, *more)
        if not more or (rivals and rivals[-1].free == free):
            continue
        why = f"{_listed(more)} found because a start without is far less likely"
        rivals.append(_with_free(model, free, why, settings))
    return rivals


def _with_free(model: ModelSpec, free: tuple[str, ...], why: str, settings: Settings) -> ModelSpec:
    """Model with more free parameters, and the reason."""
    return replace(
        model,
        problem=_problem(model.problem.window, free, dict(settings.fixed), settings),
        free=free,
        words=f"{model.words}, {why}",
        reasons=(*model.reasons, why),
    )


def _listed(names: tuple[str, ...]) -> str:
    words = [name.replace("_", " ") for name in names]
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _problem(window: Window, free: tuple[str, ...], known: dict[str, float], settings: Settings) -> Problem:
    rubbing = FRICTION in {*free, *known}
    linear = tuple(name for name in free if name in LINEAR and not (rubbing and name in INITIAL))
    priors = {**_floor_priors(window), **settings.priors}
    return Problem(
        window=window,
        linear=linear,
        nonlinear=tuple(name for name in free if name not in linear),
        known=known,
        priors={name: prior for name, prior in priors.items() if name in free},
    )


def _floor_priors(window: Window) -> dict[str, tuple[float, float]]:
    """Prior of the rolling resistance where the speed is extrapolated over the window."""
    if not window.speed.extrapolated:
        return {}
    loss = coasting_loss(window.bicycle)
    slope, std = float(window.speed.coefficients[1]), math.sqrt(float(window.speed.covariance[1, 1]))
    return {"rolling_resistance": (-slope / loss, std / loss)}


def _without_slip(window: Window, seconds: float) -> Window:
    """Window without the samples of its first seconds [s]."""
    kept = window.time + window.delay >= seconds
    return replace(
        window,
        lean_rate=np.where(kept, window.lean_rate, np.nan),
        yaw_rate=np.where(kept, window.yaw_rate, np.nan),
    )


def _about_speed(window: Window, names: set[str]) -> str:
    """Speed model in words; names: free and fixed parameters."""
    curve = window.speed
    since = ""
    if curve.extrapolated and "speed" not in names:
        when = window.delay + curve.origin
        place = f"{abs(when):.2f} s {'after' if when > 0.0 else 'before'} the start"
        if curve.is_stale:
            place = f"the start, a guess of more than {SPEED_STALE_AFTER_S:g} s ago,"
        since = f" from {curve.coefficients[0]:.2f} m/s at {place} on"
    if "rolling_resistance" in names:
        return f", speed falling by rolling resistance{since}"
    if curve.extrapolated:
        resistance, std = _floor_priors(window)["rolling_resistance"]
        return f", speed falling as with C_r = {resistance:.3f} +- {std:.3f}{since}"
    return "" if curve.constant else ", speed as measured"


def _about_slip(window: Window, settings: Settings) -> str:
    if not settings.slip_window:
        return ""
    if settings.slip == "leave_out":
        return f", without the first {settings.slip_window:g} s"
    return f", the front wheel slipping for {settings.slip_window:g} s"


def _about_saturation(count: int, settings: Settings) -> str:
    how = {"drop": "left out", "censor": "taken as at least that large", "use": "taken as they are"}
    return f", {count} saturated samples {how[settings.saturation]}" if count else ""


def _free(window: Window, settings: Settings) -> tuple[str, ...]:
    if settings.free is not None:
        free = list(settings.free)
    else:
        absent = [
            name
            for name, channel in zip(BIASES, window.measured.T, strict=True)
            if not np.isfinite(channel).any()
        ]
        free = [name for name in DEFAULT_FREE if name not in absent and name not in settings.fixed]
        free += [name for name in settings.priors if name in PARAMETERS and name not in free]
        coasts = bool(_coasting_reason(window, settings))
        if coasts and window.speed.is_stale and "speed" not in free:
            free.append("speed")
        falling = settings.speed_model == "decelerating" or coasts
        if falling and "rolling_resistance" not in {*free, *settings.fixed}:
            free.append("rolling_resistance")
    if settings.slip_window and settings.slip == "yaw_offset" and SLIP not in {*free, *settings.fixed}:
        free.append(SLIP)
    return tuple(free)
