"""Discretisation of the bicycle's equations of motion at varying speed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from tms_fit.response.even_steps import even_transitions
from tms_fit.window import Window
from tms_model import Bicycle, ParameterError
from tms_model.acceleration import coasting_loss
from tms_model.bicycle import Array
from tms_model.exponential import expm
from tms_model.response import FASTEST, state_matrix, torque_column, yaw_row
from tms_model.varying_speed import transitions_from, varying_system

MIN_SPEED = 0.05  # [m/s] of a rolling bicycle


@dataclass(frozen=True, eq=False)
class Transitions:
    """Discrete state-space model of a window.

    x[k] = transitions[k] x[k - 1] + torque_steps[k] T[k - 1], where x[-1] is the state at the start. States
    in the order of tms_model.response.STATE; the yaw rate is yaw[k] x[k]. The torque before the first sample
    is that of the first sample.
    """

    transitions: Array  # (n, 4, 4)
    torque_steps: Array  # (n, 4), per N m
    yaw: Array  # (n, 4)
    speeds: Array  # (n,) [m/s]


def known_values(window: Window) -> dict[str, float]:
    """Values of the nonlinear parameters by the window, before a fit.

    Without `rolling_resistance` the speed follows the window's speed curve; `speeds_at` defines the speed
    with `rolling_resistance` and without `speed`.
    """
    return {
        "speed": window.start_speed,
        "strike_time": -window.delay,
        "lean_rate_gain": window.lean_rate_gain,
        "steer_damper": 0.0,
        "mounting_pitch": 0.0,
    }


def speeds_at(window: Window, nonlinear: Mapping[str, float], times: Array) -> Array:
    """Speeds (n,) [m/s] at times (n,) [s] since the first sample, for nonlinear parameters by name.

    Without `rolling_resistance`, the speed runs parallel to the window's curve; with it, it falls by
    C_r g m / m_eff per second, from `speed` at the start on, or, where that isn't given and the curve is
    extrapolated, from when it was measured on.
    """
    values, curve = {**known_values(window), **nonlinear}, window.speed
    follows = curve.extrapolated and "speed" not in nonlinear
    start = values["strike_time"]
    if "rolling_resistance" in values:
        falling = values["rolling_resistance"] * coasting_loss(window.bicycle)
        since = times - (curve.origin if follows else start)
        speeds: Array = (float(curve.coefficients[0]) if follows else values["speed"]) - falling * since
        return speeds
    if curve.constant:
        return np.full(len(times), values["speed"])
    speeds = curve.at(times)
    return speeds if follows else speeds + (values["speed"] - curve.at(start))


def discretize(window: Window, nonlinear: Mapping[str, float]) -> Transitions:
    """Transitions of a window for nonlinear parameters by name; others have their `known_values`.

    The speed is that of `speeds_at`. Raises ParameterError for a speed below MIN_SPEED at some sample, for a
    start after the first sample, and for a bicycle without the parameters that a varying speed requires.
    """
    values = {**known_values(window), **nonlinear}
    start = values["strike_time"]
    if not start <= (window.time[0] if len(window.time) else 0.0):
        raise ParameterError(f"strike_time: expected no later than the first sample, found {start:g} s")
    times = np.append(start, window.time)
    bicycle = as_ridden(window.bicycle, values["lean_rate_gain"], values["steer_damper"])
    falling = None
    if "rolling_resistance" in values:
        falling = values["rolling_resistance"] * coasting_loss(window.bicycle)
    speeds = speeds_at(window, nonlinear, times)
    if not (np.isfinite(speeds).all() and (speeds >= MIN_SPEED).all() and (speeds <= FASTEST).all()):
        raise ParameterError(
            f"speed: expected {MIN_SPEED:g} to {FASTEST:g} m/s over the whole window, found"
            f" {speeds.min():g} to {speeds.max():g}; fit a shorter window"
        )
    transitions, torque_steps = _transitions(bicycle, times, speeds, window, falling)
    return Transitions(transitions, torque_steps, yaw_row(bicycle, speeds[1:]), speeds[1:])


def _transitions(
    bicycle: Bicycle, times: Array, speeds: Array, window: Window, falling: float | None
) -> tuple[Array, Array]:
    """Transitions (n, 4, 4) and torque steps (n, 4); falling: constant deceleration [m/s^2], or None."""
    # Whole nanoseconds, so that equal steps share one matrix in spite of rounding. The first step is exact,
    # since the strike time may be estimated, and a minimiser does not converge on a grid.
    steps = np.diff(times)
    steps[1:] = np.round(steps[1:], 9)
    if (speeds == speeds[0]).all():
        distinct, index = np.unique(steps, return_inverse=True)
        generator = np.zeros((5, 5))
        generator[:4, :4], generator[:4, 4] = state_matrix(bicycle, float(speeds[0])), torque_column(bicycle)
        exponential = expm(generator * distinct[:, None, None])[index]
        return exponential[:, :4, :4], exponential[:, :4, 4]
    if falling is not None:
        found = _falling_evenly(bicycle, steps, speeds[:-1], -falling, window)
        if found is not None:
            return found[:, :4, :4], found[:, :4, 4]
    first = 1 if steps[0] == 0.0 else 0  # the strike fell on the first sample
    system = varying_system(bicycle, times[first:], speeds[first:], window.resistance)
    if not first:
        return system.transitions, system.torque_steps
    return (
        np.concatenate([np.eye(4)[None], system.transitions]),
        np.concatenate([np.zeros((1, 4)), system.torque_steps]),
    )


def _falling_evenly(
    bicycle: Bicycle, steps: Array, speeds: Array, acceleration: float, window: Window
) -> Array | None:
    """Transitions (n, 5, 5) where most steps but the first are equal; None where they aren't."""
    distinct, index, counts = np.unique(steps[1:], return_inverse=True, return_counts=True)
    if not len(distinct):
        return None
    usual = int(np.argmax(counts))
    even = 1 + np.flatnonzero(index == usual)
    series = even_transitions(bicycle, speeds[even], acceleration, float(distinct[usual]), window.resistance)
    if series is None:
        return None
    # The first step is not rounded, since the strike time may be estimated; others follow lost samples.
    single = np.append(0, 1 + np.flatnonzero(index != usual))
    lengths = steps[single]
    some = lengths > 0.0  # the strike may fall on the first sample
    changes = np.full(int(some.sum()), acceleration)
    found = np.empty((len(steps), 5, 5))
    found[even], found[0] = series, np.eye(5)
    if some.any():
        rows = single[some]
        found[rows] = transitions_from(bicycle, speeds[rows], changes, lengths[some], window.resistance)
    return found


def as_ridden(bicycle: Bicycle, lean_rate_gain: float, steer_damper: float = 0.0) -> Bicycle:
    """Bicycle with the controller and the steer damper of the run added to its own steer elements."""
    if not (lean_rate_gain or steer_damper):
        return bicycle
    own = bicycle.steer_elements
    elements = replace(
        own,
        lean_rate_gain=own.lean_rate_gain + own.steer_torque_gain * lean_rate_gain,
        steer_damper=own.steer_damper + steer_damper,
    )
    return replace(bicycle, steer_elements=elements)
