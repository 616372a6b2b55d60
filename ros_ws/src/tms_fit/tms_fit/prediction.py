"""What the bicycle predicts for the two channels, linear in the initial states and the biases."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from tms_model import discretise, response, yaw_rate
from tms_model.bicycle import Array
from tms_model.response import LEAN_RATE

from tms_fit.settings import BIASES, INITIAL, LINEAR
from tms_fit.window import Window


@dataclass(frozen=True, eq=False)
class Predictor:
    """Channels of a window as `columns @ parameters + forced`, parameters in the order of LINEAR."""

    columns: Array  # (n, 2, 6)
    forced: Array  # (n, 2) [rad/s], by the known steer torque

    def select(self, names: tuple[str, ...]) -> Array:
        """Columns (n, 2, p) of some parameters."""
        return self.columns[:, :, [LINEAR.index(name) for name in names]]

    def predict(self, parameters: dict[str, float]) -> Array:
        """Lean rate and yaw rate (n, 2) [rad/s]; parameters left out are zero."""
        values = np.array([parameters.get(name, 0.0) for name in LINEAR])
        predicted: Array = self.columns @ values + self.forced
        return predicted


def predictor(window: Window) -> Predictor:
    """Predictor of a window, its initial state held at `window.start_ns`."""
    channels = _channels(window)
    unit = channels(response(window.system, np.eye(4), window.time))  # from the first sample on
    phi, gamma = discretise(window.system, window.delay)
    columns = np.zeros((len(window.time), 2, len(LINEAR)))
    columns[:, :, : len(INITIAL)] = unit @ phi
    for channel in range(len(BIASES)):
        columns[:, channel, len(INITIAL) + channel] = 1.0
    forced = np.zeros((len(window.time), 2))
    if window.steer_torque is not None and len(window.time):
        torque = np.nan_to_num(window.steer_torque)
        forced = channels(response(window.system, gamma * torque[0], window.time, torque))
    return Predictor(columns, forced)


def _channels(window: Window) -> Callable[[Array], Array]:
    """States (n, 4, ...) -> lean rate and yaw rate (n, 2, ...)."""
    return lambda states: np.stack([states[:, LEAN_RATE], yaw_rate(window.system, states)], axis=1)
