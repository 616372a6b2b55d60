"""Free responses whose truth is known, made without sensors: noise of every kind."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from tms_fit.parameters import shaping
from tms_fit.response.prediction import predictor
from tms_fit.speed_profile import constant_speed
from tms_fit.window import Window
from tms_model import load_bicycle
from tms_model.bicycle import Array

BICYCLE, SPEED, LEAN_RATE, NOISE = "tms_eq_10_1", 3.6, 0.5, 0.02  # - , m/s, rad/s, rad/s per sample
RATE, DURATION = 100.0, 1.5  # [Hz], [s]

NoiseMaker = Callable[[np.random.Generator, Array, int], Array]  # -> (runs, n, 2) [rad/s] at times (n,)


def truth(values: Mapping[str, float] | None = None, duration: float = DURATION) -> Window:
    """A window without noise: the strike of `LEAN_RATE`, other parameters by name, in the field's units.

    The window says nothing of those others: its speed is constant, its sensor level, its bicycle unaided.
    """
    time = np.arange(round(duration * RATE) + 1) / RATE
    nothing = np.zeros(len(time))
    window = Window(0, time, nothing, nothing, load_bicycle(BICYCLE), constant_speed(SPEED))
    given = {"initial_lean_rate": LEAN_RATE, **(values or {})}
    return with_rates(window, predictor(window, shaping(given)).predict(given))


def with_rates(window: Window, rates: Array) -> Window:
    """The window with other rates (n, 2)."""
    return replace(window, lean_rate=rates[:, 0], yaw_rate=rates[:, 1])


def white(rng: np.random.Generator, time: Array, runs: int) -> Array:
    """White noise."""
    return NOISE * rng.standard_normal((runs, len(time), 2))


def shimmy(rng: np.random.Generator, time: Array, runs: int) -> Array:
    """White noise, and 20 Hz of 0.05 rad/s in the yaw rate, of random phase that wanders."""
    noise = white(rng, time, runs)
    wander = 0.7 * np.cumsum(rng.standard_normal((runs, len(time))), axis=1) / np.sqrt(RATE)
    phase = 2.0 * np.pi * (20.0 * time + rng.random((runs, 1))) + wander
    noise[:, :, 1] += 0.05 * np.sin(phase)
    return noise


def colored_noise(time_constant: float) -> NoiseMaker:
    """Noise with memory: first-order autoregressive, its correlation falling with a time constant [s]."""

    def make(rng: np.random.Generator, time: Array, runs: int) -> Array:
        kept = np.exp(-1.0 / RATE / time_constant)
        noise = rng.standard_normal((runs, len(time), 2))
        for k in range(1, len(time)):
            noise[:, k] = kept * noise[:, k - 1] + np.sqrt(1.0 - kept**2) * noise[:, k]
        return NOISE * noise

    return make


def outliers(rng: np.random.Generator, time: Array, runs: int) -> Array:
    """White noise; two samples in a hundred are off by ten deviations more."""
    noise = white(rng, time, runs)
    off = rng.random(noise.shape) < 0.02
    noise[off] += 10.0 * NOISE * rng.standard_normal(int(off.sum()))
    return noise


def lossy(rng: np.random.Generator, time: Array, runs: int) -> Array:
    """White noise; one packet in five is lost."""
    noise = white(rng, time, runs)
    noise[rng.random((runs, len(time))) < 0.2] = np.nan
    return noise
