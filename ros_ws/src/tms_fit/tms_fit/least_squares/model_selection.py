"""What a fit does where its settings leave it open: chosen from the window, and said in words."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from tms_model.acceleration import coasting_loss

from tms_fit.estimate import Estimate
from tms_fit.least_squares.problem import Problem
from tms_fit.parameters import BIASES, DEFAULT_FREE, FRICTION, INITIAL, LINEAR, SLIP
from tms_fit.settings import Settings
from tms_fit.speed_profile import SPEED_STALE_AFTER_S, constant_speed
from tms_fit.window import Window, with_channels, without_saturated

FALLING = {"speed", "rolling_resistance"}
LONG = 2.0  # [s] window from which on a falling speed shows in the rates alone
UNSTEADY = (("initial_steer_rate",), ("initial_steer_rate", "initial_lean", "initial_steer"))


@dataclass(frozen=True, eq=False)
class ModelSpec:
    """A problem to be solved, and what was decided to come to it."""

    problem: Problem
    free: tuple[str, ...]  # in the order asked for
    noise: str  # noise model of NOISES, or 'auto'
    words: str  # for the message: empty, or beginning with a comma
    reasons: tuple[str, ...] = ()  # of what the data decided, a phrase each
    coasting: str = ""  # that of them why a rolling resistance is found


def choose(window: Window, settings: Settings) -> ModelSpec:
    """The problem that settings pose in this window."""
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
    why = _coasting(window, settings)
    return ModelSpec(
        problem=_problem(window, free, known, settings),
        free=free,
        noise=settings.noise,
        words="".join(words),
        reasons=(why,) if why else (),
        coasting=why,
    )


def _coasting(window: Window, settings: Settings) -> str:
    """Why a rolling resistance is found that nobody asked for; an empty text: it isn't."""
    asked = settings.free is not None or settings.speed_model != "auto"
    given = {"rolling_resistance"} & {*settings.fixed, *settings.priors}
    if asked or given or not window.speed.extrapolated:
        return ""
    if window.speed.is_stale and "speed" not in settings.priors:
        within = f"within {SPEED_STALE_AFTER_S:g} s"
        return f"speed and rolling resistance found because no speed was measured {within}"
    return "rolling resistance found because the speed was not measured over the window"


def without_resistance(choice: ModelSpec, settings: Settings) -> ModelSpec:
    """The same with the measured speed all along, instead of a rolling resistance that nobody asked for."""
    window, curve = choice.problem.window, choice.problem.window.speed
    constant = constant_speed(float(curve.coefficients[0]), curve.std, measured=True)
    found = {"rolling_resistance"} if not curve.is_stale or "speed" in settings.priors else FALLING
    free = tuple(name for name in choice.free if name not in found)
    problem = _problem(replace(window, speed=constant), free, dict(settings.fixed), settings)
    return replace(choice, problem=problem, free=free)


def at_found(choice: ModelSpec, estimate: Estimate) -> ModelSpec:
    """The same with what shapes the response held at the values of an estimate."""
    problem = choice.problem
    held = {name: estimate.parameters[name] for name in problem.nonlinear}
    priors = {name: prior for name, prior in problem.priors.items() if name not in held}
    return replace(
        choice, problem=replace(problem, nonlinear=(), known={**problem.known, **held}, priors=priors)
    )


def decelerating(choice: ModelSpec, settings: Settings) -> ModelSpec | None:
    """The same with speed and rolling resistance free, if nothing speaks for or against a constant speed."""
    window = choice.problem.window
    asked = settings.free is not None or settings.speed_model != "auto"
    if asked or window.speed.measured or len(window.time) < 2 or window.time[-1] < LONG:
        return None
    if FALLING & {*settings.fixed, *choice.free}:
        return None
    free = (*choice.free, "speed", "rolling_resistance")
    why = "speed and rolling resistance found because a constant speed is far less likely"
    return _more(choice, free, why, settings)


def unsteady(choice: ModelSpec, settings: Settings) -> list[ModelSpec]:
    """The same with a steer rate at the start, and lean and steer beside it, if nobody said what is free.

    A strike that also kicks the steering, or ends before the wheels roll again, leaves the bicycle so. Where
    the rolling resistance is found, too, a steer rate alone isn't tried: with a resistance that is off it may
    look like all three, and the interval would hold neither.
    """
    if settings.free is not None:
        return []
    taken = {*settings.fixed, *choice.free}
    rivals: list[ModelSpec] = []
    for names in UNSTEADY[-1:] if choice.coasting else UNSTEADY:
        more = tuple(name for name in names if name not in taken)
        free = (*choice.free, *more)
        if not more or (rivals and rivals[-1].free == free):
            continue
        why = f"{_listed(more)} found because a start without is far less likely"
        rivals.append(_more(choice, free, why, settings))
    return rivals


def _more(choice: ModelSpec, free: tuple[str, ...], why: str, settings: Settings) -> ModelSpec:
    """The choice with more free, for a reason."""
    return replace(
        choice,
        problem=_problem(choice.problem.window, free, dict(settings.fixed), settings),
        free=free,
        words=f"{choice.words}, {why}",
        reasons=(*choice.reasons, why),
    )


def _listed(names: tuple[str, ...]) -> str:
    words = [name.replace("_", " ") for name in names]
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _problem(window: Window, free: tuple[str, ...], known: dict[str, float], settings: Settings) -> Problem:
    rubbing = FRICTION in {*free, *known}
    linear = tuple(name for name in free if name in LINEAR and not (rubbing and name in INITIAL))
    return Problem(
        window=window,
        linear=linear,
        nonlinear=tuple(name for name in free if name not in linear),
        known=known,
        priors={
            name: prior for name, prior in {**_of_floors(window), **settings.priors}.items() if name in free
        },
    )


def _of_floors(window: Window) -> dict[str, tuple[float, float]]:
    """What is known of the rolling resistance where the speed wasn't measured over the window."""
    if not window.speed.extrapolated:
        return {}
    loss = coasting_loss(window.bicycle)
    slope, std = float(window.speed.coefficients[1]), math.sqrt(float(window.speed.covariance[1, 1]))
    return {"rolling_resistance": (-slope / loss, std / loss)}


def _without_slip(window: Window, seconds: float) -> Window:
    """The window without what was measured in its first seconds."""
    kept = window.time + window.delay >= seconds
    return replace(
        window,
        lean_rate=np.where(kept, window.lean_rate, np.nan),
        yaw_rate=np.where(kept, window.yaw_rate, np.nan),
    )


def _about_speed(window: Window, names: set[str]) -> str:
    """What the speed is taken for; names: what is free or fixed."""
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
        resistance, std = _of_floors(window)["rolling_resistance"]
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
        free += [name for name in settings.priors if name not in free]
        coasts = bool(_coasting(window, settings))
        if coasts and window.speed.is_stale and "speed" not in free:
            free.append("speed")
        falling = settings.speed_model == "decelerating" or coasts
        if falling and "rolling_resistance" not in {*free, *settings.fixed}:
            free.append("rolling_resistance")
    if settings.slip_window and settings.slip == "yaw_offset" and SLIP not in {*free, *settings.fixed}:
        free.append(SLIP)
    return tuple(free)
