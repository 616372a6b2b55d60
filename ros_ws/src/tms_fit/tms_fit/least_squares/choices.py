"""What a fit does where its settings leave it open: chosen from the window, and said in words."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tms_fit.least_squares.projection import Problem
from tms_fit.settings import BIASES, DEFAULT_FREE, FRICTION, INITIAL, LINEAR, SLIP, FitSettings
from tms_fit.window import Window, with_channels, without_saturated

LONG = 2.0  # [s] window from which on a falling speed shows in the rates alone
UNSTEADY = (("initial_steer_rate",), ("initial_steer_rate", "initial_lean", "initial_steer"))


@dataclass(frozen=True, eq=False)
class Choice:
    """A problem to be solved, and what was decided to come to it."""

    problem: Problem
    free: tuple[str, ...]  # in the order asked for
    noise: str  # noise model of NOISES, or 'auto'
    words: str  # for the message: empty, or beginning with a comma
    reasons: tuple[str, ...] = ()  # of what the data decided, a phrase each


def choose(window: Window, settings: FitSettings) -> Choice:
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
    if "rolling_resistance" in {*free, *known}:
        words.append(", speed falling by rolling resistance")
    elif not window.speed.constant:
        words.append(", speed as measured")
    return Choice(_problem(window, free, known, settings), free, settings.noise, "".join(words))


def decelerating(choice: Choice, settings: FitSettings) -> Choice | None:
    """The same with speed and rolling resistance free, if nothing speaks for or against a constant speed."""
    window = choice.problem.window
    asked = settings.free is not None or settings.speed_model != "auto"
    if asked or window.speed.measured or len(window.time) < 2 or window.time[-1] < LONG:
        return None
    if {"speed", "rolling_resistance"} & {*settings.fixed, *choice.free}:
        return None
    free = (*choice.free, "speed", "rolling_resistance")
    why = "speed and rolling resistance found because a constant speed is far less likely"
    return _more(choice, free, why, settings)


def unsteady(choice: Choice, settings: FitSettings) -> list[Choice]:
    """The same with a steer rate at the start, and lean and steer beside it, if nobody said what is free.

    A strike that also kicks the steering, or ends before the wheels roll again, leaves the bicycle so.
    """
    if settings.free is not None:
        return []
    taken = {*settings.fixed, *choice.free}
    rivals: list[Choice] = []
    for names in UNSTEADY:
        more = tuple(name for name in names if name not in taken)
        free = (*choice.free, *more)
        if not more or (rivals and rivals[-1].free == free):
            continue
        why = f"{_listed(more)} found because a start without is far less likely"
        rivals.append(_more(choice, free, why, settings))
    return rivals


def _more(choice: Choice, free: tuple[str, ...], why: str, settings: FitSettings) -> Choice:
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


def _problem(
    window: Window, free: tuple[str, ...], known: dict[str, float], settings: FitSettings
) -> Problem:
    rubbing = FRICTION in {*free, *known}
    linear = tuple(name for name in free if name in LINEAR and not (rubbing and name in INITIAL))
    return Problem(
        window=window,
        linear=linear,
        nonlinear=tuple(name for name in free if name not in linear),
        known=known,
        priors={name: prior for name, prior in settings.priors.items() if name in free},
    )


def _without_slip(window: Window, seconds: float) -> Window:
    """The window without what was measured in its first seconds."""
    kept = window.time + window.delay >= seconds
    return replace(
        window,
        lean_rate=np.where(kept, window.lean_rate, np.nan),
        yaw_rate=np.where(kept, window.yaw_rate, np.nan),
    )


def _about_slip(window: Window, settings: FitSettings) -> str:
    if not settings.slip_window:
        return ""
    if settings.slip == "leave_out":
        return f", without the first {settings.slip_window:g} s"
    return f", the front wheel slipping for {settings.slip_window:g} s"


def _about_saturation(count: int, settings: FitSettings) -> str:
    how = {"drop": "left out", "censor": "taken as at least that large", "use": "taken as they are"}
    return f", {count} saturated samples {how[settings.saturation]}" if count else ""


def _free(window: Window, settings: FitSettings) -> tuple[str, ...]:
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
        if settings.speed_model == "decelerating" and "rolling_resistance" not in {*free, *settings.fixed}:
            free.append("rolling_resistance")
    if settings.slip_window and settings.slip == "yaw_offset" and SLIP not in {*free, *settings.fixed}:
        free.append(SLIP)
    return tuple(free)
