"""What a fit does where its settings leave it open: chosen from the window, and said in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tms_fit.projection import Problem
from tms_fit.settings import BIASES, DEFAULT_FREE, LINEAR, FitSettings
from tms_fit.window import Window, with_channels


@dataclass(frozen=True, eq=False)
class Choice:
    """A problem to be solved, and what was decided to come to it."""

    problem: Problem
    free: tuple[str, ...]  # in the order asked for
    words: str  # for the message, empty or beginning with a space or a comma


def choose(window: Window, settings: FitSettings) -> Choice:
    """The problem that settings pose in this window."""
    window = with_channels(window, settings.channels)
    free = _free(window, settings)
    known = dict(settings.fixed)
    words = ""
    if "rolling_resistance" in {*free, *known}:
        words = ", speed falling by rolling resistance"
    elif not window.speed.constant:
        words = ", speed as measured"
    problem = Problem(
        window=window,
        linear=tuple(name for name in free if name in LINEAR),
        nonlinear=tuple(name for name in free if name not in LINEAR),
        known=known,
        priors={name: prior for name, prior in settings.priors.items() if name in free},
    )
    return Choice(problem, free, words)


def _free(window: Window, settings: FitSettings) -> tuple[str, ...]:
    if settings.free is not None:
        return settings.free
    absent = [
        name
        for name, channel in zip(BIASES, window.measured.T, strict=True)
        if not np.isfinite(channel).any()
    ]
    free = [name for name in DEFAULT_FREE if name not in absent and name not in settings.fixed]
    free += [name for name in settings.priors if name not in free]
    if settings.speed_model == "decelerating" and "rolling_resistance" not in {*free, *settings.fixed}:
        free.append("rolling_resistance")
    return tuple(free)
