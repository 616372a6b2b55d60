"""Response with regularised Coulomb friction of the steering (headset).

    torque = -T clip(steer rate / CREEP_RATE, -1, 1)

Below CREEP_RATE the friction is proportional to the steer rate, so the steering creeps and does not stick.
The friction of a step of at most MAX_STEP_S is that of its mean steer rate (implicit midpoint rule; without
friction the steps are exact). The response is nonlinear in the initial state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from tms_fit.parameters import FRICTION, INITIAL
from tms_fit.response.discretization import Transitions, as_ridden, discretize, known_values
from tms_fit.window import Window
from tms_model import Bicycle
from tms_model.bicycle import Array
from tms_model.response import STATE

CREEP_RATE = 0.0005  # [rad/s]
MAX_STEP_S = 0.001
STEER_RATE = STATE.index("steer_rate")


def friction_response(window: Window, values: Mapping[str, float]) -> tuple[Array, Transitions]:
    """States (n, 4) at a window's samples, and the transitions over the small steps between them.

    values: nonlinear parameters by name, friction [N m] and initial state among them. Raises ParameterError
    as `tms_fit.response.discretization.discretize` does.
    """
    named = {**known_values(window), **values}
    friction = named[FRICTION]
    times, places = _finer(window.time, named["strike_time"])
    bicycle, gain = _without_torque_gain(window, named["lean_rate_gain"])
    fine = replace(window, bicycle=bicycle, time=times, lean_rate_gain=0.0)
    moved = discretize(fine, {**values, "lean_rate_gain": 0.0})
    known = np.zeros(len(times))
    if window.steer_torque is not None:
        held = gain * np.nan_to_num(window.steer_torque)
        interval = np.searchsorted(places, np.arange(len(times)))  # that of the sample at its end
        known = held[np.maximum(interval - 1, 0)]
    states = np.empty((len(times), 4))
    state = np.array([named.get(name, 0.0) for name in INITIAL])
    push = moved.torque_steps
    soft = CREEP_RATE + 0.5 * friction * push[:, STEER_RATE]
    for k, transition in enumerate(moved.transitions):
        free = transition @ state + push[k] * known[k]
        turning = 0.5 * (state[STEER_RATE] + free[STEER_RATE]) / soft[k]
        state = free - push[k] * (friction * min(max(turning, -1.0), 1.0))
        states[k] = state
    return states[places], replace(moved, yaw=moved.yaw[places])


def _finer(time: Array, start: float) -> tuple[Array, Array]:
    """Times [s] of steps of at most MAX_STEP_S from the start, and places (n,) of the samples among them."""
    ends = np.append(start, time)
    counts = np.maximum(np.ceil(np.round(np.diff(ends) / MAX_STEP_S, 6)).astype(int), 1)
    parts = [
        low + (high - low) * np.arange(1, count + 1) / count
        for low, high, count in zip(ends[:-1], ends[1:], counts, strict=True)
    ]
    return np.concatenate(parts), np.cumsum(counts) - 1


def _without_torque_gain(window: Window, lean_rate_gain: float) -> tuple[Bicycle, float]:
    """Bicycle with the run's controller and unit steer torque gain, and the steer torque gain."""
    ridden = as_ridden(window.bicycle, lean_rate_gain)
    whole = replace(ridden.steer_elements, steer_torque_gain=1.0)
    return replace(ridden, steer_elements=whole), window.bicycle.steer_elements.steer_torque_gain
