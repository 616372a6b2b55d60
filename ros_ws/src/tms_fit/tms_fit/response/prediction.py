"""Prediction of lean and yaw rate, linear in initial state and biases, with derivatives.

The columns depend on the other parameters (NONLINEAR). Derivatives by these are central differences with a
relative error of 2e-7 (a test compares them with Richardson extrapolation).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from tms_fit.estimate import Estimate
from tms_fit.parameters import BIASES, FRICTION, INITIAL, LINEAR, SLIP, STRIKE
from tms_fit.response.discretization import Transitions, discretize, known_values
from tms_fit.response.friction import friction_response
from tms_fit.window import Window
from tms_model import ParameterError
from tms_model.bicycle import Array
from tms_model.response import LEAN_RATE

STEPS = {  # of finite differences, SI; that of the speed is relative
    "speed": 1e-4,
    "rolling_resistance": 1e-4,
    "strike_time": 1e-5,
    "lean_rate_gain": 1e-5,
    "steer_damper": 1e-5,
    "mounting_pitch": 1e-5,
    FRICTION: 1e-4,
    **dict.fromkeys(INITIAL, 1e-4),  # with friction only
}
MAX_GROWTH = 1e50  # of a response relative to its initial state, whose square does not overflow


@dataclass(frozen=True, eq=False)
class Predictor:
    """Predicted rates `columns @ parameters + forced`, with parameters in the order of LINEAR.

    With Coulomb friction the response is nonlinear in the initial state: its columns are zero and `forced`
    includes it.
    """

    columns: Array  # (n, 2, 7)
    forced: Array  # (n, 2) [rad/s], due to the known steer torque

    def select(self, names: tuple[str, ...]) -> Array:
        """Columns (n, 2, p) of some linear parameters."""
        return self.columns[:, :, [LINEAR.index(name) for name in names]]

    def predict(self, parameters: Mapping[str, float]) -> Array:
        """Lean rate and yaw rate (n, 2) [rad/s]; linear parameters left out are zero."""
        values = np.array([parameters.get(name, 0.0) for name in LINEAR])
        predicted: Array = self.columns @ values + self.forced
        return predicted


def predictor(window: Window, nonlinear: Mapping[str, float] | None = None) -> Predictor:
    """Predictor of a window for nonlinear parameters by name; others have the window's values.

    With `steer_coulomb_friction` the initial state is among them (`tms_fit.settings.shaping`), 0 if left out.

    Raises ParameterError as `tms_fit.response.discretization.discretize` does, and for a response that grows
    by more than MAX_GROWTH within the window.
    """
    return _predictor(window, tuple(sorted((nonlinear or {}).items())))


@lru_cache(maxsize=32)  # shared by rival noise models and hypotheses
def _predictor(window: Window, nonlinear: tuple[tuple[str, float], ...]) -> Predictor:
    values = dict(nonlinear)
    columns = np.zeros((len(window.time), 2, len(LINEAR)))
    forced = np.zeros((len(window.time), 2))
    with np.errstate(over="ignore", invalid="ignore"):
        if FRICTION in values:
            states, moved = friction_response(window, values)
            forced[:] = np.stack([states[:, LEAN_RATE], np.einsum("ki,ki->k", moved.yaw, states)], axis=1)
        else:
            columns[:, :, : len(INITIAL)], forced[:] = _channels(
                discretize(window, values), window.steer_torque
            )
        if not (np.abs(columns) < MAX_GROWTH).all() or not (np.abs(forced) < MAX_GROWTH).all():
            raise ParameterError(
                f"response: expected rates below {MAX_GROWTH:g} times those at the start over the whole"
                " window, found larger ones: such a bicycle falls at once; see speed, lean_rate_gain and the"
                " bicycle"
            )
    pitch = values.get("mounting_pitch", 0.0)
    if pitch:
        columns, forced = _pitched(pitch, columns), _pitched(pitch, forced)
    for channel in range(len(BIASES)):
        columns[:, channel, len(INITIAL) + channel] = 1.0
    if window.slip_window:
        since = window.time - values.get("strike_time", -window.delay)
        columns[:, 1, LINEAR.index(SLIP)] = np.maximum(1.0 - since / window.slip_window, 0.0)
    return Predictor(columns, forced)


def derivative(window: Window, nonlinear: Mapping[str, float], name: str) -> Predictor:
    """Derivative of the predictor by one nonlinear parameter, at values by name."""
    centre = {**known_values(window), **nonlinear}.get(name, 0.0)
    step = STEPS[name] * (centre if name == "speed" else max(1.0, abs(centre)))  # a smaller one is rounding
    low, high = centre - step, centre + step
    if name == "strike_time":
        high = min(high, 0.0)  # there is no free response before the strike
    ends = [predictor(window, {**nonlinear, name: value}) for value in (low, high)]
    columns, forced = (
        (getattr(ends[1], part) - getattr(ends[0], part)) / (high - low) for part in ("columns", "forced")
    )
    return Predictor(columns, forced)


def predict_by(window: Window, estimate: Estimate) -> tuple[Array, Array]:
    """Both channels (n, 2) [rad/s] as an estimate predicts them, and their derivatives (n, 2, p)."""
    nonlinear = estimate.nonlinear
    if window.speed.extrapolated and "speed" not in estimate.names:
        del nonlinear["speed"]  # follows from the extrapolated curve and the free parameters
    model = predictor(window, nonlinear)
    columns = [_slope(window, model, estimate, nonlinear, name) for name in estimate.names]
    return model.predict(estimate.complete), np.stack(columns, axis=2)


def _slope(
    window: Window, model: Predictor, estimate: Estimate, nonlinear: Mapping[str, float], name: str
) -> Array:
    """Derivative (n, 2) of an estimate's prediction by one of its parameters."""
    if name in STRIKE:  # it acted before the free response, whose start is a parameter of its own
        return np.zeros(model.forced.shape)
    if name in LINEAR and name not in nonlinear:
        return model.columns[:, :, LINEAR.index(name)]
    return derivative(window, nonlinear, name).predict(estimate.complete)


def _channels(moved: Transitions, steer_torque: Array | None) -> tuple[Array, Array]:
    """Lean and yaw rate (n, 2, 4) per initial state and (n, 2) due to a known torque (n,) or None."""
    states = _free(moved.transitions) if steer_torque is None else _forced(moved, np.nan_to_num(steer_torque))
    yaw = np.matmul(moved.yaw[:, None, :], states)[:, 0]
    both = np.stack([states[:, LEAN_RATE], yaw], axis=1)
    return both[:, :, :4], both[:, :, 4]


def _free(transitions: Array) -> Array:
    """States (n, 4, 5) per initial state without torque: the last column is zero."""
    count = len(transitions)
    states = np.zeros((count, 4, 5))
    if not count:
        return states
    states[0, :, :4] = transitions[0]
    if count > 2 and (transitions[1:] == transitions[1]).all():
        # Equal steps: the next k states are the first k, each k steps later.
        known, power = 1, transitions[1]
        while known < count:
            more = min(known, count - known)
            np.matmul(power, states[:more], out=states[known : known + more])
            known, power = known + more, power @ power
        return states
    states[:, :, :4] = _products(transitions)
    return states


def _products(transitions: Array) -> Array:
    """Running products (n, 4, 4): within all blocks at once, then from block to block."""
    count = len(transitions)
    width = math.isqrt(count)
    products = np.empty((-(-count // width), width, 4, 4))
    rows = products.reshape(-1, 4, 4)
    rows[:count], rows[count:] = transitions, np.eye(4)
    for k in range(1, width):
        products[:, k] = products[:, k] @ products[:, k - 1]
    for block in range(1, len(products)):
        products[block] = products[block] @ products[block - 1, -1]
    return rows[:count]


def _forced(moved: Transitions, torque: Array) -> Array:
    """States (n, 4, 5) per initial state, and in the last column due to a known torque (n,)."""
    states = np.zeros((len(moved.transitions), 4, 5))
    state = np.eye(4, 5)
    for k, transition in enumerate(moved.transitions):
        np.dot(transition, state, out=states[k])
        state = states[k]
        state[:, 4] += moved.torque_steps[k] * torque[max(k - 1, 0)]
    return states


def _pitched(pitch: float, rates: Array) -> Array:
    """Lean and yaw rates (n, 2, ...) as measured by a sensor pitched nose up by an angle [rad]."""
    cos, sin = math.cos(pitch), math.sin(pitch)
    return np.stack([cos * rates[:, 0] - sin * rates[:, 1], sin * rates[:, 0] + cos * rates[:, 1]], axis=1)
